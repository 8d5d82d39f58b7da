"""The picture of recorded runs: everything at once, as columns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.diagnosis.discontinuities import sentence_about
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.as_available import AsAvailable
from trajeval_ros.metrics.availability import AvailableSamples
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.viewer import appearance, colours, entity_data, scene_entities, text_panel
from trajeval_ros.viewer.appearance import ErrorScale
from trajeval_ros.viewer.blueprint import blueprint
from trajeval_ros.viewer.consistency_bands import send_consistency
from trajeval_ros.viewer.fix_map import is_on_map, send_map
from trajeval_ros.viewer.named_frames import NamedFrames
from trajeval_ros.viewer.paths import (
    between_origins,
    bounds_of,
    gaps,
    origin_for,
    peaks,
    pieces,
    size_of,
    spread,
)
from trajeval_ros.viewer.recording_properties import send_of_evaluations
from trajeval_ros.viewer.sinks import recording_writer
from trajeval_ros.viewer.state_lanes import send_fixes, send_gaps

_MOST_POINTS = 50_000  # of a path
_MOST_ROWS = 900  # rows that a viewer draws per frame, of all paths together
_MOST_POSES = 3000
_MOST_CORRESPONDENCES = 100
_MOST_NUMBERS = 20_000  # of a series
_COLOURED_PER_ROW = 8


def write_recording(
    path: Path,
    evaluations: Sequence[Evaluation],
    consistencies: Sequence[Consistency | None] = (),
    available: Sequence[AsAvailable | None] = (),
) -> None:
    """Write a Rerun file (.rrd) with estimates evaluated against one groundtruth."""
    consistencies = [
        None if consistency is None or consistency.covariances is None else consistency
        for consistency in consistencies
    ] or [None] * len(evaluations)
    samples = [None if item is None else item.samples for item in available]
    names = [evaluation.estimate.name or "estimate" for evaluation in evaluations]
    estimates = [scene_entities.EstimateEntities(name, place) for place, name in enumerate(names)]
    groundtruth = evaluations[0].groundtruth
    origin = origin_for(groundtruth.positions)
    bounds = _bounds(evaluations, origin)
    layout = blueprint(
        estimates,
        evaluations[0].protocol.gauge,
        is_live=False,
        has_consistency=any(consistencies),
        has_available=any(samples),
        has_map=is_on_map(groundtruth.reading.fixes, groundtruth.up),
        bounds=bounds,
        positions_m=np.concatenate([evaluation.absolute.position_m for evaluation in evaluations]),
        rotations_deg=_rotations(evaluations),
    )
    title = ", ".join(estimate.name for estimate in estimates)

    def draw(recording: Any) -> None:
        _draw(recording, evaluations, consistencies, estimates, origin, size_of(bounds))
        for sample, entities in zip(samples, estimates, strict=False):
            _send_available(recording, sample, entities)
        drawn = [estimate.name for estimate in estimates]
        send_of_evaluations(recording, title, evaluations, consistencies, drawn)

    write_whole(path, recording_writer(title, layout, draw))


def _rotations(evaluations: Sequence[Evaluation]) -> Floats:
    """Return the rotation errors of all estimates (N,), degrees."""
    known = [evaluation.absolute.rotation_deg for evaluation in evaluations]
    return np.concatenate([item for item in known if item is not None] or [np.empty(0)])


def _draw(
    recording: Any,
    evaluations: Sequence[Evaluation],
    consistencies: Sequence[Consistency | None],
    estimates: Sequence[scene_entities.EstimateEntities],
    origin: Floats,
    size_m: float,
) -> None:
    first = evaluations[0]
    appearance.declare(
        recording, estimates, first.protocol.gauge, first.groundtruth.up, is_live=False
    )
    full_m = colours.scale_for(np.concatenate([item.absolute.position_m for item in evaluations]))
    scale = ErrorScale.of(full_m, size_m)
    recording.log(*scale.row(), static=True)
    appearance.declare_axes(recording, estimates, size_m)
    groundtruth = first.groundtruth
    rows = max(50, _MOST_ROWS // (1 + 2 * len(evaluations)))
    send_path(recording, scene_entities.GroundtruthEntities.path.past, groundtruth, origin, rows)
    _send_poses(recording, scene_entities.GroundtruthEntities.pose, groundtruth, origin)
    start = entity_data.marker(groundtruth.positions[0] - origin, colours.GROUNDTRUTH)
    recording.log(scene_entities.GroundtruthEntities.start, start, static=True)
    remarks = []
    for evaluation, consistency, entities in zip(
        evaluations, consistencies, estimates, strict=True
    ):
        _draw_estimate(recording, evaluation, entities, origin, scale, rows)
        sentences = list(evaluation.warnings)
        if consistency is not None:
            factor = send_consistency(recording, evaluation, consistency, entities, origin)
            sentences.append(
                f"ellipsoids: {scene_entities.SIGMAS:g} sigma, enlarged {factor:g} times"
            )
            sentences.append(consistency.statement)
        elif evaluation.estimate.covariances is not None:
            its_origin = origin_for(evaluation.estimate.positions)
            _send_covariances(recording, entities.covariance, evaluation.estimate, its_origin)
        name = f"{entities.name}: " if len(estimates) > 1 else ""
        remarks += [f"{name}{item}" for item in sentences]
    if is_on_map(groundtruth.reading.fixes, groundtruth.up):
        send_map(recording, evaluations, estimates)
    if origin.any():
        remarks.append(text_panel.origin_in_words(origin))
    entity_data.send_origin(recording, origin)
    names = [estimate.name for estimate in estimates]
    words = text_panel.of_evaluations(evaluations, consistencies, names, scale, remarks)
    recording.log(scene_entities.SUMMARY, entity_data.summary(words), static=True)
    _send_events(recording, evaluations, names)
    _send_lanes(recording, evaluations, estimates)
    _send_frames(recording, evaluations, estimates, origin)


def _draw_estimate(
    recording: Any,
    evaluation: Evaluation,
    entities: scene_entities.EstimateEntities,
    origin: Floats,
    scale: ErrorScale,
    rows: int,
) -> None:
    estimate, pairs = evaluation.estimate, evaluation.association
    its_origin = origin_for(estimate.positions)
    similarity = between_origins(evaluation.alignment.similarity, origin, its_origin)
    recording.log(entities.frame, entity_data.alignment(similarity), static=True)
    send_path(recording, entities.path.past, estimate, its_origin, rows)
    _send_poses(recording, entities.pose, estimate, its_origin)
    _send_by_error(recording, entities.by_error, evaluation, its_origin, scale.full_m, rows)
    some = spread(len(pairs), _MOST_CORRESPONDENCES)
    groundtruth, aligned = pairs.groundtruth.positions[some], evaluation.aligned.positions[some]
    joined = entity_data.correspondences(
        groundtruth - origin, aligned - origin, scale.full_m, scale.factor
    )
    joined.send(recording, entities.correspondences, pairs.estimate.stamps[some])
    _send_numbers(recording, evaluation, entities)


def send_path(
    recording: Any, entity: str, trajectory: Trajectory, origin: Floats, most: int
) -> None:
    """Send a path as at most `most` pieces of lines, from an origin (3,)."""
    some = spread(len(trajectory), _MOST_POINTS)
    stamps, points = trajectory.stamps[some], trajectory.positions[some] - origin
    rows = pieces(len(some), gaps(stamps), most)
    if len(rows):
        entity_data.lines(points[rows]).send(recording, entity, stamps[rows[:, -1]])


def _send_by_error(
    recording: Any, entity: str, evaluation: Evaluation, origin: Floats, full_m: float, most: int
) -> None:
    paired = evaluation.association.estimate
    some = spread(len(paired), _MOST_POINTS)
    stamps, points = paired.stamps[some], paired.positions[some] - origin
    errors = evaluation.absolute.position_m[some]
    rows = pieces(len(some), gaps(stamps), _COLOURED_PER_ROW * most)
    if not len(rows):
        return
    begins = np.arange(0, len(rows), _COLOURED_PER_ROW)
    ends = np.minimum(begins + _COLOURED_PER_ROW, len(rows))
    path = entity_data.path_by_error(points, errors, rows, full_m)
    path.send(recording, entity, stamps[rows[ends - 1, -1]], ends - begins)


def _send_poses(recording: Any, entity: str, trajectory: Trajectory, origin: Floats) -> None:
    some = spread(len(trajectory), _MOST_POSES)
    quaternions = None if trajectory.quaternions is None else trajectory.quaternions[some]
    poses = entity_data.poses(trajectory.positions[some] - origin, quaternions)
    poses.send(recording, entity, trajectory.stamps[some])


def _send_covariances(recording: Any, entity: str, trajectory: Trajectory, origin: Floats) -> None:
    assert trajectory.covariances is not None
    some = spread(len(trajectory), _MOST_POSES)
    covariances = trajectory.covariances[some, :3, :3]
    usable = np.isfinite(covariances).all(axis=(1, 2))
    some, covariances = some[usable], covariances[usable]
    if covariances.any():
        ellipsoids = entity_data.ellipsoids(trajectory.positions[some] - origin, covariances)
        ellipsoids.send(recording, entity, trajectory.stamps[some])


def _send_numbers(
    recording: Any, evaluation: Evaluation, entities: scene_entities.EstimateEntities
) -> None:
    stamps, errors = evaluation.association.estimate.stamps, evaluation.absolute
    ends = stamps[[0, -1]]
    for quantity, column in (
        (scene_entities.POSITION_ERROR, errors.position_m),
        (scene_entities.ROTATION_ERROR, errors.rotation_deg),
        (scene_entities.YAW_ERROR, errors.yaw_deg),
    ):
        if column is not None:
            send_series(recording, entities.metric(quantity), stamps, column)
            after = stamps[:-1][gaps(stamps)] + 1
            if len(after):  # the viewer panics at a chunk without rows
                nothing = entity_data.numbers(np.full(len(after), np.nan))  # ends the line
                nothing.send(recording, entities.metric(quantity), after)
    for quantity, metric in (
        (scene_entities.ATE_POSITION, "position_m"),
        (scene_entities.ATE_ROTATION, "rotation_deg"),
    ):
        rmse = text_panel.rmse_of(evaluation.ate, metric)
        if rmse is not None:
            level = np.full(2, rmse)
            send_series(recording, entities.metric(quantity), ends, level)
    if evaluation.protocol.gauge.has_scale:
        level = np.full(2, evaluation.alignment.similarity.scale)
        send_series(recording, entities.metric(scene_entities.SCALE), ends, level)
    for place, segment in enumerate(evaluation.relative or ()):
        if segment.count:
            length = str(segment.length)
            appearance.declare_length(recording, entities, length, place)
            send_series(
                recording,
                entities.metric(scene_entities.RELATIVE_ERROR, length),
                stamps[segment.errors.ends],
                segment.errors.position_m,
            )


def _send_available(
    recording: Any, samples: AvailableSamples | None, entities: scene_entities.EstimateEntities
) -> None:
    if samples is not None:
        appearance.declare_available(recording, entities)
        for quantity, column in (
            (scene_entities.AVAILABLE_POSITION, samples.position_m),
            (scene_entities.POSE_AGE, samples.age / NANOSECONDS),
        ):
            send_series(recording, entities.metric(quantity), samples.stamps, column)


def send_series(recording: Any, entity: str, stamps: Stamps, values: Floats) -> None:
    """Send a series of numbers; of many, peaks are kept."""
    some = peaks(values, _MOST_NUMBERS)
    entity_data.numbers(values[some]).send(recording, entity, stamps[some])


def _send_events(recording: Any, evaluations: Sequence[Evaluation], names: Sequence[str]) -> None:
    for evaluation, name in zip(evaluations, names, strict=True):
        stamps = evaluation.association.estimate.stamps
        for row in np.flatnonzero(gaps(stamps)).tolist():
            step = int(stamps[row + 1] - stamps[row])
            _say(recording, stamps[row + 1], text_panel.gap_in_words(name, step))
        first_ns = int(evaluation.groundtruth.stamps.min())
        for event in evaluation.events:
            text = f"{name}: {sentence_about(event, first_ns)}"
            _say(recording, np.int64(event.end_ns), text)
        for warning in evaluation.warnings:
            _say(recording, stamps[-1], f"{name}: {warning}")
        _say(recording, stamps[0], f"{name}: first of {counted(len(stamps), 'pair')}", warn=False)


def _send_lanes(
    recording: Any,
    evaluations: Sequence[Evaluation],
    estimates: Sequence[scene_entities.EstimateEntities],
) -> None:
    groundtruth = evaluations[0].groundtruth
    fixes = groundtruth.reading.fixes
    if fixes is not None and len(fixes) == len(groundtruth):
        send_fixes(recording, groundtruth.stamps, fixes.status)
    for evaluation, entities in zip(evaluations, estimates, strict=True):
        stamps = evaluation.association.estimate.stamps
        send_gaps(recording, entities.tracking, stamps, gaps(stamps))


def _send_frames(
    recording: Any,
    evaluations: Sequence[Evaluation],
    estimates: Sequence[scene_entities.EstimateEntities],
    origin: Floats,
) -> None:
    frames, groundtruth = NamedFrames(), evaluations[0].groundtruth
    frames.attach(groundtruth.frame, scene_entities.WORLD, origin)
    for evaluation, entities in zip(evaluations, estimates, strict=True):
        estimate = evaluation.estimate
        frames.attach(estimate.frame, entities.frame, origin_for(estimate.positions))
        frames.attach(estimate.child_frame, entities.pose)
    frames.attach(groundtruth.child_frame, scene_entities.GroundtruthEntities.pose)
    frames.send(recording)


def _say(recording: Any, stamp: np.int64, text: str, *, warn: bool = True) -> None:
    row = entity_data.event(text, warn=warn)
    entity_data.log(recording, scene_entities.EVENTS, int(stamp), row)


def _bounds(evaluations: Sequence[Evaluation], origin: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and largest coordinates of all paths, (3,) and (3,)."""
    paths = [
        evaluations[0].groundtruth.positions,
        *(evaluation.aligned.positions for evaluation in evaluations),
    ]
    low, high = bounds_of(paths)
    return low - origin, high - origin
