"""The pose between two frames as a receiver knows it.

Every transform holds from its reception on. Corrections such as map to odom may be dated into the
future or the past, and seldom come; a receiver uses the newest one that it has, whatever its
timestamp. Only the leading edge, which dates the poses, is filtered by timestamps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.reading import Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.stamp_trust import StampTrust
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.valid_poses import judge_poses
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey, Way, compose
from trajeval_ros.metrics.stream_health import UNKNOWN

_NEVER = int(np.iinfo(np.int64).max)


class ReceivedEdge(NamedTuple):
    """The transforms of a moving edge in the order of their reception."""

    stamps: Stamps = np.empty(0, np.int64)  # (N,) nanoseconds
    numbers: Floats = np.empty((0, 7))  # (N, 7): translation, quaternion xyzw
    times: Stamps = np.empty(0, np.int64)  # (N,) nanoseconds, of reception, may be `UNKNOWN`

    def picked(self, rows: Any) -> ReceivedEdge:
        """Return the transforms of a slice, a mask or an array of indices."""
        return ReceivedEdge._make(each[rows] for each in self)

    def joined(self, later: ReceivedEdge) -> ReceivedEdge:
        """Return these transforms and later ones."""
        return ReceivedEdge._make(map(np.concatenate, zip(self, later, strict=True)))


class ReceivedChain:
    """Composes the pose of a frame in another at every reception of a transform between them.

    The poses do not depend on how the transforms are divided into calls, so that live and recorded
    ones are the same.
    """

    def __init__(self, edges: Mapping[EdgeKey, Edge], way: Way, leading: EdgeKey) -> None:
        """Begin without received transforms; static ones are taken from `edges`."""
        self._way, self.leading, self._trust = way, leading, StampTrust()
        self._static = {key: edges[key] for key, _ in way if edges[key].is_static}
        # The transforms from the ones in use on.
        self._moving = {key: ReceivedEdge() for key, _ in way if key not in self._static}
        self._until = UNKNOWN  # reception of the newest pose

    def poses(self, new: Mapping[EdgeKey, ReceivedEdge], *, at_end: bool = False) -> Trajectory:
        """Return the poses at the receptions of new transforms, as far as these are decided.

        Timestamps are of the newest leading transform; one repeats if only a correction is new. A
        leading transform whose timestamp is under test delays all poses from its reception on.
        `at_end`: no transforms will follow.
        """
        for key in self._moving:
            self._add(key, new.get(key, ReceivedEdge()), at_end=at_end)
        moving = self._moving.values()
        events = np.unique(np.concatenate([each.times for each in moving]))
        undecided = self._trust.waiting[-1] if self._trust.waiting else [_NEVER]
        begin = max(each.times[0] if len(each.times) else _NEVER for each in moving)
        events = events[(events > self._until) & (events >= begin) & (events < undecided[0])]
        places = np.arange(len(events)) + 1
        held, corrected = dict(self._static), None
        for key, edge in self._moving.items():
            rows = edge.times.searchsorted(events, side="right") - 1
            used = edge.picked(rows)
            # An edge over the number of the event instead of time: nothing is interpolated.
            held[key] = Edge.from_columns(places, used.numbers, is_static=False)
            if key == self.leading:
                stamps = used.stamps
            else:
                corrected = used.times if corrected is None else np.maximum(corrected, used.times)
            if len(rows):
                self._moving[key] = edge.picked(slice(rows[-1], None))
        self._until = int(events[-1]) if len(events) else self._until
        reading = Reading(receptions=Receptions(events, "node", corrected=corrected))
        return Trajectory(stamps, *compose(held, self._way, places), reading=reading)

    def _add(self, key: EdgeKey, new: ReceivedEdge, *, at_end: bool) -> None:
        """Take usable transforms; one that was received with the newest pose holds just after."""
        finite, turned = judge_poses(new.numbers[:, :3], new.numbers[:, 3:])
        usable = (new.stamps != 0) & (new.times != UNKNOWN) & finite & turned
        times = np.maximum.accumulate(np.maximum(new.times, self._until + 1))
        new = new._replace(times=times).picked(usable)
        if key != self.leading:
            self._moving[key] = self._moving[key].joined(new)
            return
        joined = self._moving[key].joined(
            ReceivedEdge._make(self._trust.take(*new, at_end=at_end))
        )
        newest = np.maximum.accumulate(joined.stamps)  # late ones are never in use
        self._moving[key] = joined.picked(np.diff(newest, prepend=newest[:1] - 1) > 0)


def compose_received(
    chain: ReceivedChain, received: Mapping[EdgeKey, tuple[ReceivedEdge, Receptions]]
) -> Trajectory:
    """Return the poses of a recording, by moving edge with what its times are."""
    found = chain.poses({key: each for key, (each, _) in received.items()}, at_end=True)
    receptions, (_, by) = found.reading.receptions, received[chain.leading]
    assert receptions is not None
    receptions = replace(receptions, by=by.by, recording_s=by.recording_s)
    return replace(found, reading=Reading(receptions=receptions))
