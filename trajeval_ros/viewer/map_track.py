"""The tracks on a map: GNSS fixes and aligned estimates by latitude and longitude."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum, places_at
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.viewer import appearance, entity_data, scene_entities
from trajeval_ros.viewer.entity_data import EntityData
from trajeval_ros.viewer.paths import gaps, spread

MOST_POINTS = 5000  # of a track, and fixes


def is_on_map(fixes: Fixes | None, up: UpAxis) -> bool:
    """Return whether the groundtruth's frame has a known place and orientation on Earth.

    `up` is the up axis of the groundtruth's frame.
    """
    return fixes is not None and up.name == Z_UP.name


def track_lines(stamps: Stamps, aligned: Floats, datum: Datum) -> EntityData:
    """Return an aligned estimate as lines on the map, without those across gaps.

    Args:
        stamps: (N,) nanoseconds.
        aligned: (N, 3), metres, in the datum's frame.
        datum: Origin of the frame of the fixes.
    """
    places = places_at(aligned, datum)[:, :2]
    parts = np.split(places, np.flatnonzero(gaps(stamps)) + 1)
    return entity_data.lines_on_map([each for each in parts if len(each) > 1])


def send_map(
    recording: Any,
    evaluations: Sequence[Evaluation],
    estimates: Sequence[scene_entities.EstimateEntities],
) -> None:
    """Log the fixes, coloured by status, and the aligned estimates, for all time."""
    fixes = evaluations[0].groundtruth.fixes
    assert fixes is not None
    assert fixes.datum is not None
    appearance.declare_map(recording, estimates)
    some = spread(len(fixes), MOST_POINTS)
    dots = entity_data.fixes_on_map(fixes.places[some, :2], fixes.status[some])
    recording.log(scene_entities.MAP_FIXES, dots.row(), static=True)
    for evaluation, entities in zip(evaluations, estimates, strict=True):
        estimate = evaluation.estimate
        some = spread(len(estimate), MOST_POINTS)
        aligned = evaluation.alignment.similarity.positions(estimate.positions[some])
        lines = track_lines(estimate.stamps[some], aligned, fixes.datum)
        recording.log(entities.on_map, lines.row(), static=True)
