"""The pose between two frames as a receiver has it.

Every transform holds from its receive time on. Corrections such as map to odom may be dated into
the future or the past, and seldom come; a receiver uses the newest one that it has, whatever its
timestamp. Only the leading edge, which dates the poses, is filtered by timestamps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.outlier_stamps import OutlierStamps
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.valid_poses import valid_mask
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey, Way, compose
from trajeval_ros.metrics.stream_health import UNKNOWN

_AFTER_ALL = int(np.iinfo(np.int64).max)  # later than every receive time
# A transform: timestamp in nanoseconds, translation and quaternion xyzw, and receive time in
# nanoseconds, which may be `UNKNOWN`.
TRANSFORM = np.dtype([("stamp", "<i8"), ("numbers", "<f8", 7), ("time", "<i8")])
Transforms = NDArray[np.void]  # (N,) in the order of their receive time
NO_TRANSFORMS: Transforms = np.empty(0, TRANSFORM)


def transforms_of(stamps: Stamps, numbers: Floats, times: Stamps) -> Transforms:
    """Return transforms by column: (N,), (N, 7), (N,)."""
    transforms = np.empty(len(stamps), TRANSFORM)
    transforms["stamp"], transforms["numbers"], transforms["time"] = stamps, numbers, times
    return transforms


class ReceivedChain:
    """Composes the pose of a frame in another at every receive time of a transform between them.

    The poses do not depend on how the transforms are divided into calls, so that live and recorded
    ones are the same.
    """

    def __init__(self, edges: Mapping[EdgeKey, Edge], way: Way, leading: EdgeKey) -> None:
        """Begin without received transforms; static ones are taken from `edges`."""
        self._way, self.leading, self._trust = way, leading, OutlierStamps()
        self._static = {key: edges[key] for key, _ in way if edges[key].is_static}
        # The transforms from the ones in use on.
        self._moving = {key: NO_TRANSFORMS for key, _ in way if key not in self._static}
        self._until = UNKNOWN  # receive time of the newest pose

    def poses(self, new: Mapping[EdgeKey, Transforms], *, at_end: bool = False) -> Trajectory:
        """Return the poses at the receive times of new transforms, as far as these are decided.

        Timestamps are of the newest leading transform; one repeats if only a correction is new. A
        leading transform whose timestamp is under test delays all poses from its receive time on.
        `at_end`: no transforms will follow.
        """
        for key in self._moving:
            self._add(key, new.get(key, NO_TRANSFORMS), at_end=at_end)
        times = [item["time"] for item in self._moving.values()]
        events = np.unique(np.concatenate(times))
        begin = max(time[0] if len(time) else _AFTER_ALL for time in times)
        undecided = self._trust.waiting[1]["time"][0] if self._trust.waiting else _AFTER_ALL
        events = events[(events > self._until) & (events >= begin) & (events < undecided)]
        places = np.arange(len(events)) + 1
        held, corrected = dict(self._static), None
        for key, edge in self._moving.items():
            rows = edge["time"].searchsorted(events, side="right") - 1
            used = edge[rows]
            # An edge over the number of the event instead of time: nothing is interpolated.
            held[key] = Edge.from_columns(places, used["numbers"], is_static=False)
            if key == self.leading:
                stamps = used["stamp"]
            else:
                since = used["time"]
                corrected = since if corrected is None else np.maximum(corrected, since)
            if len(rows):
                self._moving[key] = edge[rows[-1] :]
        self._until = int(events[-1]) if len(events) else self._until
        reading = SourceInfo(receive_times=ReceiveTimes(events, "node", corrected=corrected))
        return Trajectory(stamps, *compose(held, self._way, places), reading=reading)

    def _add(self, key: EdgeKey, new: Transforms, *, at_end: bool) -> None:
        """Take usable transforms; one that was received with the newest pose holds just after."""
        finite, is_rotation = valid_mask(new["numbers"][:, :3], new["numbers"][:, 3:])
        new = new[(new["stamp"] != 0) & (new["time"] != UNKNOWN) & finite & is_rotation]
        new["time"] = np.maximum.accumulate(np.maximum(new["time"], self._until + 1))
        if key == self.leading:
            _, new = self._trust.take(new["stamp"], new, at_end=at_end)
        joined = np.concatenate([self._moving[key], new])
        if key == self.leading:  # late ones are never in use
            newest = np.maximum.accumulate(joined["stamp"])
            joined = joined[np.diff(newest, prepend=newest[:1] - 1) > 0]
        self._moving[key] = joined


def compose_received(
    chain: ReceivedChain, received: Mapping[EdgeKey, tuple[Transforms, ReceiveTimes]]
) -> Trajectory:
    """Return the poses of a recording, by moving edge with what its times are."""
    poses = chain.poses({key: item for key, (item, _) in received.items()}, at_end=True)
    receive_times, (_, by) = poses.reading.receive_times, received[chain.leading]
    assert receive_times is not None
    receive_times = replace(receive_times, by=by.by, recording_s=by.recording_s)
    return replace(poses, reading=SourceInfo(receive_times=receive_times))
