"""Results of a live evaluator: after every batch of messages, and on request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.online.live_relative_errors import RelativeEnd, RunningErrors
from trajeval_ros.online.pair_errors import PairErrors

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.consistency.result import Consistency, PerPose


@dataclass(frozen=True, eq=False)
class Update:
    """The results of new pairs.

    Attributes:
        pairs: Number of new pairs.
        stamp: Timestamp of the newest pair, nanoseconds; None without new pairs.
        errors: Errors of the new pairs, block by block; empty without an alignment.
        ends: Sub-trajectories that ended.
    """

    pairs: int = 0
    stamp: int | None = None
    errors: tuple[PairErrors, ...] = ()
    ends: tuple[RelativeEnd, ...] = ()

    @property
    def position_m(self) -> float | None:
        """Position error of the newest pair, metres; None without new pairs or alignment."""
        return float(self.errors[-1].position_m[-1]) if self.errors else None

    @property
    def rotation_deg(self) -> float | None:
        """Rotation error of the newest pair, degrees; None if not available."""
        angles = self.errors[-1].rotation_deg if self.errors else None
        return None if angles is None else float(angles[-1])


def united(updates: Sequence[Update]) -> Update:
    """Return consecutive updates as one."""
    newest = next((update for update in reversed(updates) if update.stamp is not None), Update())
    return replace(
        newest,
        pairs=sum(update.pairs for update in updates),
        errors=tuple(block for update in updates for block in update.errors),
        ends=tuple(end for update in updates for end in update.ends),
    )


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of an evaluation.

    Attributes:
        pairs: Number of pairs so far.
        warming_up: Why there is no alignment yet; empty if there is one.
        alignment: The present alignment.
        position_rmse_m: Position ATE of the run so far.
        window_position_rmse_m: Position ATE of the window.
        ate: Statistics of the window's absolute errors by metric.
        window_pairs: Number of pairs in the window.
        relative: Errors of sub-trajectories so far, by length.
        estimate_coverage: Share of estimated states in a pair, without waiting ones.
        coverage: Share of the groundtruth's time that the pairs cover; None before the first pair.
        dropped: Number of estimated states without a pair by reason.
        waiting: Number of waiting states.
        consistency: Consistency test of the window's pairs; None if not configured or not
            possible.
        why_not_consistency: Why the test is not possible; empty otherwise.
        integrity: Errors of the window against protection levels; None likewise.
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
        """The window's NEES of single poses; None if not available."""
        return None if self.consistency is None else self.consistency.per_pose
