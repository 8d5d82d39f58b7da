"""What a live evaluator tells: after every batch of messages, and when it is asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.online.relative_errors import RelativeEnd, RunningErrors


@dataclass(frozen=True, eq=False)
class Update:
    """What new pairs brought.

    Attributes:
        pairs: Number of new pairs.
        stamp: Of the newest pair, nanoseconds; None if there is no new one.
        position_m: Its position error under the present alignment.
        rotation_deg: Its rotation error; None if it can't be had.
        ends: Sub-trajectories that ended.
    """

    pairs: int = 0
    stamp: int | None = None
    position_m: float | None = None
    rotation_deg: float | None = None
    ends: tuple[RelativeEnd, ...] = ()


def united(updates: Sequence[Update]) -> Update:
    """Return several updates, in order, as one."""
    newest = next((each for each in reversed(updates) if each.stamp is not None), Update())
    ends = tuple(end for each in updates for end in each.ends)
    return replace(newest, pairs=sum(each.pairs for each in updates), ends=ends)


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
