"""Results of a live evaluator: after every batch of messages, and on request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.discontinuities.events import Loss
from trajeval_ros.metrics.premises import Doubts
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.online.live_relative_errors import RelativeEnd, RunningErrors
from trajeval_ros.online.pair_errors import PairErrors

if TYPE_CHECKING:
    from trajeval_ros.consistency.consistency_result import Consistency, PerPose
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.formatting.remarks import Remark


@dataclass(frozen=True, eq=False)
class Update:
    """The results of new pairs; the errors are block by block, none without an alignment."""

    pairs: int = 0  # number of new pairs
    stamp: int | None = None  # timestamp of the newest pair, nanoseconds; None without new pairs
    errors: tuple[PairErrors, ...] = ()
    ends: tuple[RelativeEnd, ...] = ()  # sub-trajectories that ended

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
    """The state of an evaluation; a result that is not available or not configured is None."""

    pairs: int  # number of pairs so far
    stamp: int | None  # timestamp of the newest pair, nanoseconds; None without a pair
    warming_up: str  # why there is no alignment yet; empty if there is one
    alignment: Alignment | None  # the present alignment
    position_rmse_m: float | None  # position ATE of the run so far
    window_position_rmse_m: float | None  # position ATE of the window
    ate: dict[str, Statistics | None]  # statistics of the window's absolute errors by metric
    window_pairs: int  # number of pairs in the window
    relative: dict[str, RunningErrors]  # errors of sub-trajectories so far, by length
    estimate_coverage: float | None  # share of estimated states in a pair, without waiting ones
    coverage: Coverage | None  # of the groundtruth's time by pairs
    dropped: dict[str, int]  # number of estimated states without a pair by reason
    waiting: int  # number of waiting states
    consistency: Consistency | None = None  # test of the window's pairs
    why_not_consistency: str = ""  # why the test is not possible; empty otherwise
    integrity: Integrity | None = None  # errors of the window against protection levels
    loss: Loss | None = None  # loss of tracking at the newest pair
    ate_before_loss_m: float | None = None  # position ATE of the run until it
    about_yaw: Remark | None = None  # warning about covariances that claim to know yaw
    doubts: Doubts = field(default_factory=Doubts)  # about what the withheld errors rely on

    @property
    def nees(self) -> PerPose | None:
        """The window's NEES of single poses; None if not available."""
        return None if self.consistency is None else self.consistency.per_pose
