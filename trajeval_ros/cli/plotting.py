"""Options for the figures of `trajeval trajectory`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.cli.options import FIGURES, option
from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import PLANES
from trajeval_ros.io.writing import refused_by_disk
from trajeval_ros.report.figure_output import save_all
from trajeval_ros.report.figure_style import PLAIN, FigureStyle
from trajeval_ros.report.motion_figures import COLOURS_BY, PLOTS, Colours, motion_drawings

PLOT_OPTIONS = (
    option("--plot", metavar="LIST", panel=FIGURES,
        help=f"Figures to draw into the output folder, separated by commas: {','.join(PLOTS)}. "
        "Positions (xyz), angles (rpy) and speeds are drawn over time."),
    option("--colour-by", metavar="|".join(COLOURS_BY), panel=FIGURES,
        help="Colour of paths in a plane: error (distance from the reference) or speed."),
    option("--colour-max", kind=float, metavar="VALUE", panel=FIGURES,
        help="Value at the end of the colour scale. Default: the 99th percentile."),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Plotting:
    """The requested figures."""

    kinds: tuple[str, ...]  # names of figures in `PLOTS`; empty for no figures
    colours: Colours | None  # along paths; None for one colour per trajectory
    style: FigureStyle

    @classmethod
    def parse(
        cls,
        plot: str | None,
        colour_by: str | None,
        colour_max: float | None,
        style: FigureStyle,
    ) -> Plotting:
        """Parse the options."""
        more = (colour_by, colour_max)
        if plot is None and (style != PLAIN or any(item is not None for item in more)):
            raise SettingsError(
                f"the options of figures need --plot; add it, as in --plot {PLOTS[0]}"
            )
        kinds = () if plot is None else tuple(dict.fromkeys(plot.split(",")))
        for kind in kinds:
            require_one_of(kind, PLOTS, "plot")
        if colour_by is not None:
            require_one_of(colour_by, COLOURS_BY, "colour")
        if colour_by is not None and not set(kinds) & set(PLANES):
            raise SettingsError(
                f"--colour-by needs a path in a plane; add {', '.join(PLANES)} to --plot"
            )
        if colour_max is not None and (colour_by is None or not 0.0 < colour_max < math.inf):
            raise SettingsError(
                f"--colour-max must be positive and needs --colour-by; found {colour_max:g}"
            )
        style.check()
        colours = None if colour_by is None else Colours(colour_by, colour_max)
        return cls(kinds, colours, style)

    def write(
        self, folder: Path, trajectories: Sequence[Trajectory], reference: Trajectory | None
    ) -> list[Path]:
        """Draw the figures into a folder, and return their files; earlier ones are replaced."""
        if not self.kinds:
            return []
        drawings = motion_drawings(self.kinds, trajectories, reference, colours=self.colours)
        with refused_by_disk(f"the folder {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
        return save_all(drawings, folder, self.style)
