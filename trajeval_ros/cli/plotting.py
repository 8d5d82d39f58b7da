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
from trajeval_ros.io.ground_image import GroundImage, parse_bounds, read_ground_image
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
    option("--map", "map_file", kind=Path, metavar="FILE", panel=FIGURES,
        help="Background of the path in xy: a ROS map (its YAML file), or an image with a world "
        "file next to it. It must be in the frame of the drawn trajectories."),
    option("--map-bounds", metavar="X0,Y0,X1,Y1", panel=FIGURES,
        help="Lower left and upper right corner of an image without a world file, in metres."),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Plotting:
    """The requested figures."""

    kinds: tuple[str, ...]  # names of figures in `PLOTS`; empty for no figures
    colours: Colours | None  # along paths; None for one colour per trajectory
    ground: GroundImage | None  # map below the paths
    style: FigureStyle

    @classmethod
    def parse(
        cls,
        plot: str | None,
        colour_by: str | None,
        colour_max: float | None,
        map_file: Path | None,
        map_bounds: str | None,
        style: FigureStyle,
    ) -> Plotting:
        """Parse the options and read the map."""
        more = (colour_by, colour_max, map_file, map_bounds)
        if plot is None and (style != PLAIN or any(each is not None for each in more)):
            raise SettingsError(
                f"the options of figures need --plot; add it, as in --plot {PLOTS[0]}"
            )
        kinds = () if plot is None else tuple(dict.fromkeys(plot.split(",")))
        for each in kinds:
            require_one_of(each, PLOTS, "plot")
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
        if map_bounds is not None and map_file is None:
            raise SettingsError("--map-bounds needs an image; add --map IMAGE")
        if map_file is not None and "xy" not in kinds:
            raise SettingsError("--map needs the figure xy; add xy to --plot")
        style.check()
        bounds = None if map_bounds is None else parse_bounds(map_bounds)
        ground = None if map_file is None else read_ground_image(map_file, bounds)
        colours = None if colour_by is None else Colours(colour_by, colour_max)
        return cls(kinds, colours, ground, style)

    def write(
        self, folder: Path, trajectories: Sequence[Trajectory], reference: Trajectory | None
    ) -> list[Path]:
        """Draw the figures into a folder, and return their files; earlier ones are replaced."""
        if not self.kinds:
            return []
        drawings = motion_drawings(
            self.kinds, trajectories, reference, colours=self.colours, ground=self.ground
        )
        with refused_by_disk(f"the folder {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
        return save_all(drawings, folder, self.style)
