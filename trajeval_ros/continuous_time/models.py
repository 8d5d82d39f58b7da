"""Names of the models, without the code that fits them."""

from __future__ import annotations

# Candidates of `auto`, which compares them on held-out samples.
CANDIDATES = ("matern", "wnoa", "wnoj")
MODELS = (*CANDIDATES, "matern32", "matern52", "paper", "linear", "nearest", "auto")
# Some motion is rougher than Matern-5/2. The kernel is chosen by the samples, for positions and
# rotations separately. With 5/2 only, 95 % regions cover 75 % of poses on recordings at a few
# hertz. With 3/2 only, smooth flights are so uncertain that hardly a pose supports an error of 1
# cm.
DEFAULT_MODEL = "matern"
# Models without additional uncertainty between samples.
WITHOUT_UNCERTAINTY = ("linear", "nearest")
