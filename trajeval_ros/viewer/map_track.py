"""The tracks on a map: GNSS fixes and aligned estimates by latitude and longitude."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.formatting.palette import FIX_STATUS_PLACES
from trajeval_ros.geometry.geodesy import places_at
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.viewer import colours, scene_entities
from trajeval_ros.viewer.paths import gaps, spread
from trajeval_ros.viewer.sdk import sdk

_MOST_POINTS = 5000  # of a track, and fixes
_DOT, _LINE = 2.0, 2.0


def has_map(evaluations: Sequence[Evaluation]) -> bool:
    """Return whether it is known where on earth the groundtruth is."""
    truth = evaluations[0].groundtruth
    return truth.fixes is not None and truth.up.name == "z"


def send_map(
    recording: Any,
    evaluations: Sequence[Evaluation],
    estimates: Sequence[scene_entities.EstimateEntities],
) -> None:
    """Log the fixes, coloured by status, and the aligned estimates, for all time."""
    rerun, _ = sdk()
    fixes = evaluations[0].groundtruth.fixes
    assert fixes is not None
    assert fixes.datum is not None
    some = spread(len(fixes), _MOST_POINTS)
    coloured = [
        colours.GROUNDTRUTH
        if (place := FIX_STATUS_PLACES.get(each)) is None
        else colours.of_estimate(place)
        for each in fixes.status[some].tolist()
    ]
    points = rerun.GeoPoints(
        lat_lon=fixes.places[some, :2],
        colors=coloured,
        radii=rerun.Radius.ui_points(_DOT),
    )
    recording.log(scene_entities.MAP_FIXES, points, static=True)
    for evaluation, entities in zip(evaluations, estimates, strict=True):
        estimate = evaluation.estimate
        some = spread(len(estimate), _MOST_POINTS)
        aligned = evaluation.alignment.similarity.positions(estimate.positions[some])
        track = places_at(aligned, fixes.datum)[:, :2]
        parts = np.split(track, np.flatnonzero(gaps(estimate.stamps[some])) + 1)
        lines = rerun.GeoLineStrings(
            lat_lon=[each for each in parts if len(each) > 1],
            colors=entities.colour,
            radii=rerun.Radius.ui_points(_LINE),
        )
        recording.log(entities.on_map, lines, static=True)
