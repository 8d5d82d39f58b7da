"""Summary of the inputs of an evaluation: counts, frames and a checksum."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis


@dataclass(frozen=True)
class FixSummary:
    """Summary of the GNSS fixes.

    Attributes:
        datum: The origin of their east-north-up frame.
        accepted: Number of fixes that are used.
        dropped: Number of messages that are not used, by reason.
        sigma_level_m: Median standard deviation along the worst horizontal axis; None if unknown.
        sigma_up_m: Median standard deviation of the height; None if unknown.
    """

    datum: Datum
    accepted: int
    dropped: dict[str, int]
    sigma_level_m: float | None
    sigma_up_m: float | None

    @classmethod
    def of(cls, fixes: Fixes, dropped: Mapping[str, int]) -> FixSummary:
        """Summarise fixes that have a datum."""
        assert fixes.datum is not None
        known = fixes.known
        level, up = (
            float(np.median(sigma[known])) if known.any() else None
            for sigma in (fixes.sigma_level_m, fixes.sigma_up_m)
        )
        return cls(fixes.datum, len(fixes), dict(dropped), level, up)


@dataclass(frozen=True)
class InputSummary:
    """One side of an evaluation, as it was read.

    Attributes:
        source: The source that it was read from; "" if unknown.
        name: Its name in tables.
        poses: Number of poses, repeated timestamps included.
        duration_s: From the earliest to the latest timestamp.
        path_length_m: Length of the path through the poses in use.
        frame: The frame of the poses.
        child_frame: The body whose poses these are.
        up: The axis of the frame that points up.
        kind: `gnss` fixes, `points` without orientation, or `poses`.
        fixes: Summary of GNSS fixes; None for other kinds.
        notes: What the reader detected or corrected, one sentence each.
        fingerprint: sha256 of the pose columns.
    """

    source: str
    name: str
    poses: int
    duration_s: float
    path_length_m: float
    frame: str
    child_frame: str
    up: UpAxis
    kind: str
    fixes: FixSummary | None
    notes: tuple[str, ...]
    fingerprint: str

    @classmethod
    def of(cls, read: Trajectory, used: Trajectory) -> InputSummary:
        """Summarise a trajectory as it was read, and as it is used (sorted)."""
        return cls(
            source=read.source,
            name=read.name,
            poses=len(read),
            duration_s=read.duration_s,
            path_length_m=used.path_length_m,
            frame=read.frame,
            child_frame=read.child_frame,
            up=read.up,
            kind=read.kind,
            fixes=None if read.fixes is None else FixSummary.of(read.fixes, read.dropped),
            notes=used.notes,
            fingerprint=fingerprint(read),
        )


def fingerprint(trajectory: Trajectory) -> str:
    """Return the sha256 of the pose columns (stamps, positions, xyzw; little-endian)."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(trajectory.stamps, dtype="<i8").data)
    digest.update(np.ascontiguousarray(trajectory.positions, dtype="<f8").data)
    if trajectory.quaternions is not None:
        digest.update(np.ascontiguousarray(trajectory.quaternions, dtype="<f8").data)
    return digest.hexdigest()
