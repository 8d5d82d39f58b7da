"""Writing of errors as an MCAP file, with the topics and messages of the live evaluator."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros import __version__
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import one_line, part_of_topic
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.frame_axes import between_own_axes
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.bags.encode_messages import (
    encode_alignment,
    encode_numbers,
    encode_paths,
    encode_stamped,
)
from trajeval_ros.io.bags.pose_messages import PATH_TYPE
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.online.error_topics import (
    ALIGNMENT,
    ALIGNMENT_TYPE,
    DIAGNOSTIC_LEVELS,
    DIAGNOSTICS,
    DIAGNOSTICS_TYPE,
    NODE,
    NUMBER_TYPE,
    NUMBERS,
    ROBOT,
    VECTOR_TYPE,
    VECTORS,
    by_part,
    relative_error_topic,
    status_texts,
    status_values,
    vectors_of,
    window_ate,
)
from trajeval_ros.online.live_relative_errors import RunningErrors
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.whole_run import ThinnedRun
from trajeval_ros.pipeline.outcome import Outcome, RunOutcome

_LATEST_NS = 2**31 * NANOSECONDS  # limit of ROS timestamps


class _Channel(NamedTuple):
    """Messages of one topic, with their log times (N,) in nanoseconds."""

    topic: str
    type: str
    times: Stamps
    messages: Iterable[bytes]


def write_error_recording(path: Path, outcome: Outcome) -> None:
    """Write errors, paths, alignments and statistics as ROS 2 messages, completely or not at all.

    The log times of errors are the timestamps of the estimate's messages: errors and the
    original recording have the same time axis. The alignment and the paths of a run are logged at
    its first pair. The statistics of the window are logged at the first and the last pair. Here
    the window is the whole run.

    Raises:
        InputError: The file can't be written, or timestamps are before 1970 or after 2038.
    """
    channels: list[_Channel] = []
    statuses = []
    for run, name in zip(outcome.runs, _topic_parts(outcome.runs), strict=True):
        recorded = _RecordedRun(outcome, run, name)
        channels += recorded.channels()
        statuses.append(recorded.status())
    times = np.concatenate([channel.times for channel in channels])
    if not 0 <= times.min() <= times.max() < _LATEST_NS:
        raise InputError(f"{path} can't have timestamps before 1970 or after 2038, a limit of ROS")
    message = _diagnostics(int(times.max()), statuses)
    channels.append(_Channel(DIAGNOSTICS, DIAGNOSTICS_TYPE, times.min(keepdims=True), [message]))
    write_whole(path, lambda temporary: _write(temporary, channels), follow_link=True)


def _topic_parts(runs: Sequence[RunOutcome]) -> list[str]:
    """Return one part of a topic's name per run, all different."""
    names = [part_of_topic(run.estimate.name) for run in runs]
    return [
        name if names.count(name) == 1 else f"{name}_{place}"
        for place, name in enumerate(names, start=1)
    ]


class _RecordedRun:
    """The messages about one estimate."""

    def __init__(self, outcome: Outcome, run: RunOutcome, name: str) -> None:
        """Compute the errors of the pairs as the live evaluator, with the final alignment."""
        self._evaluation, self._frame, self._name = run.evaluation, outcome.groundtruth.frame, name
        self._child_frame, up = run.estimate.frame, outcome.groundtruth.up
        self._sources = {
            "groundtruth": outcome.groundtruth.source,
            "estimate": run.estimate.source,
        }
        pairs, self._alignment = _as_live(run.evaluation, up, run.estimate.up)
        self._pairs = pairs.without_covariances()
        self._errors = PairErrors(pairs, self._alignment, run.evaluation.doubts)
        self._snapshot = _snapshot(run.evaluation)
        rule = run.evaluation.association.rule
        self._offset_ns = round(rule.time_offset_s * NANOSECONDS)
        self._times = self._pairs.stamps - self._offset_ns

    def channels(self) -> Iterator[_Channel]:
        """Yield the topics with their messages."""
        begin, whole = self._times[:1], self._times[[0, -1]]
        for topic in VECTORS:
            stamps, vectors = vectors_of(self._errors, topic, self._offset_ns)
            messages = _each(encode_stamped(stamps, vectors, self._frame))
            yield self._channel(topic, VECTOR_TYPE, stamps, messages)
        for topic, numbers_of in NUMBERS.items():
            if (values := numbers_of(self._errors)) is not None:
                yield self._numbers(topic, self._times, values)
        for segment in self._evaluation.relative or ():
            errors, topic = segment.errors, relative_error_topic(str(segment.length))
            numbers = by_part(topic, errors.position_m, errors.rotation_deg)
            for name, vectors in numbers.items():
                yield self._vectors(name, self._times[errors.ends], vectors)
        for topic, ate in window_ate(self._snapshot).items():
            yield self._vectors(topic, whole, ate.repeat(2, axis=0))
        frames = self._frame, self._child_frame
        transform = encode_alignment(self._alignment, self._times[-1:], frames)
        yield self._channel(ALIGNMENT, ALIGNMENT_TYPE, begin, [transform])
        thinned = ThinnedRun()
        thinned.add(self._pairs)
        for topic, path in encode_paths(thinned.pairs(), self._alignment, self._frame).items():
            yield self._channel(topic, PATH_TYPE, begin, [path])

    def status(self) -> Any:
        """Return a diagnostic_msgs/DiagnosticStatus with statistics and warnings."""
        types, warnings = _message_types().types, self._evaluation.warnings
        values = status_values(self._snapshot, Update(errors=(self._errors,)))
        return types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=DIAGNOSTIC_LEVELS[Level.WARNING if warnings else Level.NOTE],
            name=f"{NODE}: {self._name}",
            message=one_line("; ".join(warnings)) or "evaluated",
            hardware_id=ROBOT,
            values=[
                types["diagnostic_msgs/msg/KeyValue"](key, one_line(value))
                for key, value in status_texts(self._sources | values).items()
            ],
        )

    def _numbers(self, topic: str, times: Stamps, values: Floats) -> _Channel:
        return self._channel(topic, NUMBER_TYPE, times, _each(encode_numbers(values)))

    def _vectors(self, topic: str, stamps: Stamps, vectors: Floats) -> _Channel:
        messages = _each(encode_stamped(stamps, vectors, ""))
        return self._channel(topic, VECTOR_TYPE, stamps, messages)

    def _channel(
        self, topic: str, message_type: str, times: Stamps, messages: Iterable[bytes]
    ) -> _Channel:
        return _Channel(f"/{NODE}/{self._name}/{topic}", message_type, times, messages)


def _as_live(
    evaluation: Evaluation, groundtruth_up: UpAxis, estimate_up: UpAxis
) -> tuple[PairedStates, Similarity]:
    """Return the pairs and the alignment in the original axes of both frames.

    Under an upright gauge, the evaluation has turned the trajectories to z up.
    """
    pairs, similarity = evaluation.association, evaluation.alignment.similarity
    groundtruth, estimate = pairs.groundtruth, pairs.estimate
    if evaluation.protocol.is_upright:
        similarity = between_own_axes(similarity, groundtruth_up, estimate_up)
        groundtruth, estimate = (
            _rotated_back(groundtruth, groundtruth_up),
            _rotated_back(estimate, estimate_up),
        )
    groundtruth = dataclasses.replace(groundtruth, up=groundtruth_up)
    return PairedStates(groundtruth, estimate), similarity


def _rotated_back(trajectory: Trajectory, up: UpAxis) -> Trajectory:
    if up.name == "z":
        return trajectory
    return Similarity(up.matrix.T, np.zeros(3)).trajectory(trajectory)


def _snapshot(evaluation: Evaluation) -> Snapshot:
    """Return the final state of a live evaluation with the whole run as its window."""
    pairs, position = evaluation.association, evaluation.ate["position_m"]
    rmse = None if position is None else position.rmse
    relative = {}
    for item in evaluation.relative or ():
        positions, rotations = (item.statistics[name] for name in ("position_m", "rotation_deg"))
        if positions is not None and rotations is not None:
            count = item.count
            relative[str(item.length)] = RunningErrors(count, positions.mean, rotations.mean)
    return Snapshot(
        pairs=len(pairs),
        stamp=int(pairs.estimate.stamps[-1]),
        warming_up="",
        alignment=evaluation.alignment,
        position_rmse_m=rmse,
        window_position_rmse_m=rmse,
        ate=evaluation.ate,
        window_pairs=len(pairs),
        relative=relative,
        estimate_coverage=pairs.estimate_coverage,
        coverage=pairs.coverage,
        dropped=pairs.dropped,
        waiting=0,
    )


def _diagnostics(stamp: int, statuses: list[Any]) -> bytes:
    store = _message_types()
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, NANOSECONDS))
    header = store.types["std_msgs/msg/Header"](time, "")
    message = store.types[DIAGNOSTICS_TYPE](header, statuses)
    return bytes(store.serialize_cdr(message, DIAGNOSTICS_TYPE))


def _each(rows: Any) -> Iterator[bytes]:
    return (row.tobytes() for row in rows)


def _write(path: Path, channels: Sequence[_Channel]) -> None:
    """Write the messages of all channels in the order of their log times."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", f"trajeval_ros {__version__}")
        schemas = {
            name: writer.register_schema(name, "ros2msg", _definition(name))
            for name in sorted({channel.type for channel in channels})
        }
        numbers = [
            writer.register_channel(channel.topic, "cdr", schemas[channel.type])
            for channel in channels
        ]
        owners = np.repeat(np.arange(len(channels)), [len(channel.times) for channel in channels])
        times = np.concatenate([channel.times for channel in channels])
        order = np.argsort(times, kind="stable")
        payloads = [iter(channel.messages) for channel in channels]
        counts = [itertools.count() for _ in channels]
        for owner, time in zip(owners[order].tolist(), times[order].tolist(), strict=True):
            payload = next(payloads[owner])
            writer.add_message(numbers[owner], time, payload, time, next(counts[owner]))
        writer.finish()  # type: ignore[no-untyped-call]


def _definition(message_type: str) -> bytes:
    text: str = _message_types().generate_msgdef(message_type, ros_version=2)[0]
    return text.encode()


@cache
def _message_types() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)
