"""Styles of all entities, live and recorded; logged once, before the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.viewer import colours
from trajeval_ros.viewer.entity_data import LineLook, marker
from trajeval_ros.viewer.legend import declare_legend
from trajeval_ros.viewer.scene_entities import (
    ALIGNMENT_YAW,
    ATE_POSITION,
    ATE_ROTATION,
    ERRORS_WITHIN,
    MAP_FIXES,
    NEES,
    NEES_LIMIT,
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

_AXES_M = 0.4
_ON_MAP = 2.0
GROUNDTRUTH_PATH = LineLook(colours.GROUNDTRUTH, 1.2)


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
    recording.log(
        GroundtruthEntities.pose, marker(np.zeros(3), colours.GROUNDTRUTH, ""), static=True
    )
    for each in estimates:
        look = path_of_estimate(each.colour, len(estimates))
        _declare_path(recording, each.path, look, is_live=is_live)
        # Labels of several estimates overlap; their names are in the legend.
        label = each.name if len(estimates) == 1 else ""
        looks = marker(np.zeros(3), each.colour, label), rerun.TransformAxes3D(_AXES_M)
        recording.log(each.pose, *looks, static=True)
        for entity, width in ((each.by_error, 2.6), (each.correspondences, 0.8)):
            radii = [rerun.Radius.ui_points(width)]
            recording.log(entity, rerun.LineStrips3D.from_fields(radii=radii), static=True)
        _declare_ellipsoids(recording, each.covariance, each.colour)
        _declare_series(recording, each)
        if gauge.has_scale:
            _series(recording, each.metric(SCALE), f"{each.name}, scale", each.colour, 1.6)


def declare_revised(recording: Any, estimate: EstimateEntities) -> None:
    """Log the style of the error of a path's newest version."""
    label = f"{estimate.name}, ATE of the revised path"
    _series(recording, estimate.metric(REVISED_ATE_POSITION), label, _pale(estimate.colour))


def declare_length(recording: Any, estimate: EstimateEntities, length: str, place: int) -> None:
    """Log the style of the relative error of a length: longer lengths are brighter."""
    shade = 0.45 + 0.55 * min(place, 4) / 4.0
    colour = tuple(round(shade * each) for each in estimate.colour)
    _series(
        recording,
        estimate.metric(RELATIVE_ERROR, length),
        f"{estimate.name} {length}",
        colour,
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


def declare_map(recording: Any, estimates: Sequence[EstimateEntities]) -> None:
    """Log the styles of fixes and estimates on the map."""
    rerun, _ = sdk()
    radii = [rerun.Radius.ui_points(_ON_MAP)]
    recording.log(MAP_FIXES, rerun.GeoPoints.from_fields(radii=radii), static=True)
    for each in estimates:
        looks = rerun.GeoLineStrings.from_fields(colors=[each.colour], radii=radii)
        recording.log(each.on_map, looks, static=True)


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
    return tuple((each + 255) // 2 for each in colour)


def _series(recording: Any, entity: str, label: str, colour: Any, width: float = 1.2) -> None:
    rerun, _ = sdk()
    style = rerun.SeriesLines(colors=[colour], names=[label], widths=[width])
    recording.log(entity, style, static=True)
