"""The models' names: what a setting may be, without what it takes to fit one."""

from __future__ import annotations

# Of these, `auto` chooses by samples that are held out.
CANDIDATES = ("matern", "wnoa", "wnoj")
MODELS = (*CANDIDATES, "matern32", "matern52", "paper", "linear", "nearest", "auto")
# Some motion is rougher than Matern-5/2's; samples tell, for positions and rotations apart. With
# 5/2 alone, 95 % regions cover 75 % of poses on recordings at a few hertz; with 3/2 alone, smooth
# flight is believed to be so uncertain that hardly a pose supports an error of a centimetre.
DEFAULT_MODEL = "matern"
# Those that know no more between samples than at them.
WITHOUT_UNCERTAINTY = ("linear", "nearest")
