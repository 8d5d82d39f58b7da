"""Summary of the inputs of an evaluation: counts, frames and a checksum."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.source_info import DeclaredReset
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis


@dataclass(frozen=True)
class FixSummary:
    """Summary of the GNSS fixes."""

    datum: Datum  # the origin of their east-north-up frame
    accepted: int  # number of fixes that are used
    dropped: dict[str, int]  # number of messages that are not used, by reason
    # Median standard deviation along the worst horizontal axis; None if unknown.
    sigma_level_m: float | None
    sigma_up_m: float | None  # median standard deviation of the height; None if unknown

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
    """One side of an evaluation, as it was read."""

    source: str  # the source that it was read from; "" if unknown
    name: str
    poses: int  # number of poses, repeated timestamps included
    duration_s: float  # from the earliest to the latest timestamp
    path_length_m: float  # length of the path through the poses in use
    frame: str
    child_frame: str  # the body whose poses these are
    up: UpAxis  # the axis of the frame that points up
    kind: str  # `gnss` fixes, `points` without orientation, or `poses`
    fixes: FixSummary | None  # summary of GNSS fixes; None for other kinds
    remarks: tuple[Remark, ...]  # those on its reading
    fingerprint: str  # sha256 of the pose columns
    resets: tuple[DeclaredReset, ...] = ()  # resets that the estimator declares

    @classmethod
    def of(cls, read: Trajectory, used: Trajectory) -> InputSummary:
        """Summarise a trajectory as it was read, and as it is used (sorted)."""
        fixes = read.reading.fixes
        return cls(
            source=read.reading.source,
            name=read.name,
            poses=len(read),
            duration_s=read.duration_s,
            path_length_m=used.path_length_m,
            frame=read.frame,
            child_frame=read.child_frame,
            up=read.up,
            kind=read.kind,
            fixes=None if fixes is None else FixSummary.of(fixes, read.reading.dropped),
            remarks=used.reading.remarks,
            resets=read.reading.resets,
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
