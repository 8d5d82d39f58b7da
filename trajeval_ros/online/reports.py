"""What a live evaluator tells: after every batch of messages, and when it is asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.relative_errors import RelativeEnd, RunningErrors

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.consistency.result import Consistency, PerPose


@dataclass(frozen=True, eq=False)
class Update:
    """What new pairs brought.

    Attributes:
        pairs: Number of new pairs.
        stamp: Of the newest pair, nanoseconds; None if there is no new one.
        errors: Of the new pairs, block by block; none while there is no alignment.
        ends: Sub-trajectories that ended.
    """

    pairs: int = 0
    stamp: int | None = None
    errors: tuple[PairErrors, ...] = ()
    ends: tuple[RelativeEnd, ...] = ()

    @property
    def position_m(self) -> float | None:
        """Position error of the newest pair under the present alignment."""
        return float(self.errors[-1].position_m[-1]) if self.errors else None

    @property
    def rotation_deg(self) -> float | None:
        """Rotation error of the newest pair; None if it can't be had."""
        angles = self.errors[-1].rotation_deg if self.errors else None
        return None if angles is None else float(angles[-1])


def united(updates: Sequence[Update]) -> Update:
    """Return several updates, in order, as one."""
    newest = next((each for each in reversed(updates) if each.stamp is not None), Update())
    return replace(
        newest,
        pairs=sum(each.pairs for each in updates),
        errors=tuple(block for each in updates for block in each.errors),
        ends=tuple(end for each in updates for end in each.ends),
    )


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of an evaluation.

    Attributes:
        pairs: Number of pairs so far.
        warming_up: Why there is no alignment yet; empty once there is.
        alignment: The present one.
        position_rmse_m: Position ATE of the whole run so far.
        window_position_rmse_m: Position ATE of the window.
        ate: Statistics of the window's absolute errors by metric.
        window_pairs: Number of pairs in the window.
        relative: Errors of sub-trajectories so far, by length.
        estimate_coverage: Share of estimated states that are in a pair, waiting ones left out.
        coverage: How much of the groundtruth's time the pairs of the whole run cover; None while
            there is no pair.
        dropped: Estimated states in no pair, by reason.
        waiting: Estimated states that wait for groundtruth.
        consistency: Whether the covariances of the window's pairs, taken for a run of its own, fit
            its errors; None if nobody asked, or if it can't be told.
        why_not_consistency: Why it can't be told; empty if it can, or nobody asked.
        integrity: Whether the window's errors keep to their protection levels; likewise None.
    """

    pairs: int
    warming_up: str
    alignment: Alignment | None
    position_rmse_m: float | None
    window_position_rmse_m: float | None
    ate: dict[str, Statistics | None]
    window_pairs: int
    relative: dict[str, RunningErrors]
    estimate_coverage: float | None
    coverage: Coverage | None
    dropped: dict[str, int]
    waiting: int
    consistency: Consistency | None = None
    why_not_consistency: str = ""
    integrity: Integrity | None = None

    @property
    def nees(self) -> PerPose | None:
        """The window's NEES of single poses; None where it can't be had."""
        return None if self.consistency is None else self.consistency.per_pose
