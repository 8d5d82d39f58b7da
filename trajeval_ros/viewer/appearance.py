"""Styles of all entities, live and recorded; logged once, before the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.formatting import palette
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.statistics import round_below
from trajeval_ros.viewer import colours
from trajeval_ros.viewer.entity_data import LineLook, marker, pose_axes
from trajeval_ros.viewer.scene_entities import (
    ALIGNMENT_YAW,
    ATE_POSITION,
    ATE_ROTATION,
    AVAILABLE_POSITION,
    ERRORS_WITHIN,
    LEGEND,
    MAP_FIXES,
    NEES,
    NEES_LIMIT,
    POSE_AGE,
    POSITION_ERROR,
    RELATIVE_ERROR,
    REVISED_ATE_POSITION,
    ROTATION_ERROR,
    SCALE,
    SIGMAS,
    WORLD,
    YAW_ERROR,
    EstimateEntities,
    GroundtruthEntities,
    PathEntities,
)
from trajeval_ros.viewer.sdk import sdk

# Width of the strip, height of a row and width of a letter, in units of the view.
WIDTH, ROW = 1000.0, 46.0
_RAMP_END, _NAMES_BEGIN = 250.0, 330.0
_LETTER = 12.0
_MOST_BESIDE = 3
_LINE, _BELOW, _STEPS, _RADIUS = 6.0, 8.0, 64, 4.0
_SWATCH = 0.55  # of the room of a name
_SCALE = f"{LEGEND}/scale"


def declare_legend(recording: Any, estimates: Sequence[EstimateEntities]) -> None:
    """Log the colour scale of errors, and the colours and names of groundtruth and estimates."""
    rerun, _ = sdk()
    ends = np.linspace(0.0, _RAMP_END, _STEPS + 1)
    line = np.stack([ends, np.full(_STEPS + 1, _LINE)], axis=1)
    shown = [
        ("groundtruth", colours.GROUNDTRUTH),
        *((estimate.name, estimate.colour) for estimate in estimates),
    ]
    columns = -(-len(shown) // rows_of(len(estimates)))
    room = (WIDTH - _NAMES_BEGIN) / columns
    row, column = np.divmod(np.arange(len(shown)), columns)
    places = np.stack([_NAMES_BEGIN + (column + 0.5) * room, _LINE + ROW * row], axis=1)
    letters = int(room / _LETTER)
    half = np.array([0.5 * _SWATCH * room, 0.0])
    ramp = np.stack([line[:-1], line[1:]], axis=1)
    swatches = np.stack([places - half, places + half], axis=1)
    errors = colours.of_errors(np.linspace(0.0, 1.0, _STEPS), 1.0).tolist()
    lines = rerun.LineStrips2D(
        np.concatenate([ramp, swatches]),
        colors=[*errors, *(colour for _, colour in shown)],
        radii=_RADIUS,
    )
    names = [shortened(name, letters) for name, _ in shown]
    # An entity takes a kilobyte, so both are in one.
    recording.log(f"{LEGEND}/colours", lines, _texts(places + [0.0, _BELOW], names), static=True)


def _texts(places: Any, texts: Sequence[str]) -> Any:
    """Return texts below places (N, 2); their colour is readable on Rerun's light theme, too."""
    rerun, _ = sdk()
    return rerun.Points2D(places, colors=[_TEXT], radii=0.0, labels=texts, show_labels=True)


_TEXT: colours.Colour = (128, 132, 140)


def rows_of(estimates: int) -> int:
    """Return the number of rows for the names of N estimates and of the groundtruth."""
    return -(-(1 + estimates) // _MOST_BESIDE)


_VISIBLE, _ENLARGED = 0.01, 0.04  # of the size of the scene: an error that is drawn as it is


@dataclass(frozen=True)
class ErrorScale:
    """The colours of position errors, and the enlargement of the lines that show them."""

    full_m: float  # error at the end of the colours, metres
    factor: float  # of the lines

    @classmethod
    def of(cls, full_m: float, size_m: float) -> ErrorScale:
        """Return the scale for a scene of a size, metres; lines that paths hide are enlarged."""
        if full_m >= _VISIBLE * size_m:
            return cls(full_m, 1.0)
        return cls(full_m, round_below(max(1.0, _ENLARGED * size_m / full_m)))

    @property
    def in_words(self) -> str:
        """The meaning of the colours and lines."""
        words = f"{palette.RAMP_WORDS}: position error from 0 to {self.full_m:g} m"
        return words + (f"; the lines are enlarged {self.factor:g} times" * (self.factor > 1.0))

    def row(self) -> tuple[str, Any]:
        """Return the entity of the scale's labels, and the labels."""
        texts = ["0", f"lines x {self.factor:g}" * (self.factor > 1.0), f"{self.full_m:g} m"]
        places = [[share * _RAMP_END, _LINE + _BELOW] for share in (0.0, 0.5, 1.0)]
        shown = [place for place, text in enumerate(texts) if text]
        return _SCALE, _texts([places[item] for item in shown], [texts[item] for item in shown])


def shortened(name: str, letters: int) -> str:
    """Return a name with a limited number of letters: the end of a long one."""
    return name if len(name) <= letters else f"…{name[1 - letters :]}"


_ON_MAP = 2.0
GROUNDTRUTH_PATH = LineLook(colours.GROUNDTRUTH, 1.4)


def path_of_estimate(colour: colours.Colour, estimates: int) -> LineLook:
    """Return the look of the path of one of N estimates; a single one is coloured by error."""
    return LineLook(colour, 1.0 if estimates == 1 else 1.6)


def declare(
    recording: Any,
    estimates: Sequence[EstimateEntities],
    gauge: Gauge,
    up: UpAxis,
    *,
    is_live: bool,
) -> None:
    """Log the styles of all entities, and the up axis of the world.

    A style takes a kilobyte, so entities that only some runs have are declared with their data.
    """
    rerun, _ = sdk()
    way = "DOWN" if up.name.startswith("-") else "UP"
    view = f"RIGHT_HAND_{up.name[-1].upper()}_{way}"
    recording.log(WORLD, getattr(rerun.ViewCoordinates, view), static=True)
    declare_legend(recording, estimates)
    _declare_path(recording, GroundtruthEntities.path, GROUNDTRUTH_PATH, is_live=is_live)
    recording.log(GroundtruthEntities.pose, marker(np.zeros(3), colours.GROUNDTRUTH), static=True)
    for estimate in estimates:
        look = path_of_estimate(estimate.colour, len(estimates))
        _declare_path(recording, estimate.path, look, is_live=is_live)
        recording.log(estimate.pose, marker(np.zeros(3), estimate.colour), static=True)
        for entity, width in ((estimate.by_error, 2.6), (estimate.correspondences, 0.8)):
            radii = [rerun.Radius.ui_points(width)]
            recording.log(entity, rerun.LineStrips3D.from_fields(radii=radii), static=True)
        _declare_ellipsoids(recording, estimate.covariance, estimate.colour)
        _declare_series(recording, estimate)
        if gauge.has_scale:
            _series(
                recording, estimate.metric(SCALE), f"{estimate.name}, scale", estimate.colour, 1.6
            )


def declare_axes(recording: Any, estimates: Sequence[EstimateEntities], size_m: float) -> None:
    """Log the length of the axes of the newest poses, for a scene of a size, metres."""
    for estimate in estimates:
        recording.log(estimate.pose, pose_axes(_AXES * size_m), static=True)


_AXES = 0.03  # of the size of the scene


def declare_revised(recording: Any, estimate: EstimateEntities) -> None:
    """Log the style of the error of a path's newest version."""
    label = f"{estimate.name}, ATE of the revised path"
    _series(recording, estimate.metric(REVISED_ATE_POSITION), label, _pale(estimate.colour))


def declare_available(recording: Any, estimate: EstimateEntities) -> None:
    """Log the styles of the as-available error and of the age of the pose in use."""
    label = f"{estimate.name}, as available"
    _series(recording, estimate.metric(AVAILABLE_POSITION), label, _pale(estimate.colour))
    _series(recording, estimate.metric(POSE_AGE), estimate.name, estimate.colour)


def declare_length(recording: Any, estimate: EstimateEntities, length: str, place: int) -> None:
    """Log the style of the relative error of a length: longer lengths are brighter."""
    shade = 0.45 + 0.55 * min(place, 4) / 4.0
    colour = tuple(round(shade * item) for item in estimate.colour)
    _series(
        recording, estimate.metric(RELATIVE_ERROR, length), f"{estimate.name} {length}", colour
    )


def declare_consistency(recording: Any, estimate: EstimateEntities) -> None:
    """Log the styles of errors and their uncertainty."""
    rerun, _ = sdk()
    name, colour = estimate.name, estimate.colour
    _declare_ellipsoids(recording, estimate.uncertainty, colour)
    _series(recording, estimate.metric(NEES), name, colour)
    label = f"{name}, 95 % of consistent runs stay below"
    _series(recording, estimate.metric(NEES_LIMIT), label, colours.BAND, 1.6)
    for quantity in ERRORS_WITHIN:
        bands = rerun.SeriesLines(
            colors=[colour, colours.BAND, colours.BAND],
            names=[name, f"{SIGMAS:g} sigma", f"-{SIGMAS:g} sigma"],
            widths=[1.2, 1.6, 1.6],
        )
        recording.log(estimate.metric(quantity), bands, static=True)


def declare_points(recording: Any, estimate: EstimateEntities) -> None:
    """Log the style of scans: darker than the paths in them."""
    rerun, _ = sdk()
    look = rerun.Points3D.from_fields(
        colors=[colours.POINTS], radii=[rerun.Radius.ui_points(_POINT)]
    )
    recording.log(estimate.points, look, static=True)


_POINT = 0.6


def declare_map(recording: Any, estimates: Sequence[EstimateEntities]) -> None:
    """Log the styles of fixes and estimates on the map."""
    rerun, _ = sdk()
    radii = [rerun.Radius.ui_points(_ON_MAP)]
    recording.log(MAP_FIXES, rerun.GeoPoints.from_fields(radii=radii), static=True)
    for estimate in estimates:
        looks = rerun.GeoLineStrings.from_fields(colors=[estimate.colour], radii=radii)
        recording.log(estimate.on_map, looks, static=True)


def _declare_ellipsoids(recording: Any, entity: str, colour: colours.Colour) -> None:
    rerun, _ = sdk()
    ellipsoids = rerun.Ellipsoids3D.from_fields(
        colors=[(*colour, 110)], fill_mode=rerun.components.FillMode.Solid
    )
    recording.log(entity, ellipsoids, static=True)


def _declare_path(recording: Any, path: PathEntities, look: LineLook, *, is_live: bool) -> None:
    """Log the style of a path; the past of a live path has it in its few rows."""
    rerun, _ = sdk()
    for entity in (path.recent, path.newest) if is_live else (path.past,):
        recording.log(entity, rerun.LineStrips3D.from_fields(**look.fields), static=True)


def _declare_series(recording: Any, estimate: EstimateEntities) -> None:
    name, colour = estimate.name, estimate.colour
    pale = _pale(colour)
    for quantity, label, its, width in (
        (POSITION_ERROR, name, colour, 1.2),
        (ATE_POSITION, f"{name}, ATE (RMSE)", pale, 2.4),
        (ROTATION_ERROR, name, colour, 1.2),
        (ATE_ROTATION, f"{name}, ATE (RMSE)", pale, 2.4),
        (YAW_ERROR, f"{name}, yaw", colour, 1.2),
        (ALIGNMENT_YAW, f"{name}, yaw of the alignment", colour, 1.6),
    ):
        _series(recording, estimate.metric(quantity), label, its, width)


def _pale(colour: colours.Colour) -> tuple[int, ...]:
    return tuple((item + 255) // 2 for item in colour)


def _series(recording: Any, entity: str, label: str, colour: Any, width: float = 1.2) -> None:
    rerun, _ = sdk()
    style = rerun.SeriesLines(colors=[colour], names=[label], widths=[width])
    recording.log(entity, style, static=True)
