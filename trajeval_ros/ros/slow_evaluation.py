"""Slow evaluation of one estimate on a thread: hints, and the errors of its newest path."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.notices import Notice
from trajeval_ros.online.revised import RevisedPath
from trajeval_ros.online.rows_evaluation import evaluate_rows
from trajeval_ros.online.state_rows import Pairs
from trajeval_ros.online.trail import Trail
from trajeval_ros.ros.background import BackgroundTask
from trajeval_ros.ros.live_hints import hints_about

_MOST_SHARE = 0.03  # largest share of a core
# Span of the run before the first hints, and factor of its growth before the next ones.
_FIRST_S = 5.0
_GROWTH = 1.3


@dataclass(frozen=True, eq=False)
class _Findings:
    hints: list[Notice] | None
    revised: Evaluation | None


class SlowEvaluation:
    """Runs evaluations that are too slow for a tick, repeatedly.

    Attributes:
        hints: Newest hints.
        revised: Evaluation of the newest path; None for estimates that are not paths.
    """

    def __init__(self) -> None:
        """Create it without results."""
        self.hints: list[Notice] = []
        self.revised: Evaluation | None = None
        self._task: BackgroundTask[_Findings] = BackgroundTask(_MOST_SHARE)
        self._hints_at_s = _FIRST_S
        self._version = 0  # version of the evaluated path

    def renew(
        self,
        trail: Trail,
        path: RevisedPath | None,
        protocol: Protocol,
        ups: tuple[UpAxis, UpAxis],
        bodies: tuple[str, str],
        *,
        of_clocks: bool,
    ) -> bool:
        """Collect results, and start again if due; return whether a path was evaluated.

        Args:
            trail: The run, thinned to few pairs.
            path: Newest path; None for estimates that are not paths.
            protocol: The settings.
            ups: The up axes of groundtruth and estimate.
            bodies: Names of the bodies of both sides.
            of_clocks: Whether to test the clocks.
        """
        found = self._task.take()
        if found is not None:
            self.hints = self.hints if found.hints is None else found.hints
            self.revised = found.revised or self.revised
        has_revised = found is not None and found.revised is not None
        if not self._task.is_due:
            return has_revised
        some = newest = None
        stamps, truth, estimate = trail.columns()
        span_s = int(stamps[-1] - stamps[0]) / NANOSECONDS if len(stamps) else 0.0
        if span_s >= self._hints_at_s:
            self._hints_at_s = _GROWTH * span_s
            some = Pairs(stamps.copy(), truth.copy(), estimate.copy())  # since they change
        if path is not None and path.version != self._version:
            newest, self._version = path.pairs(), path.version

        def look() -> _Findings:
            return _Findings(
                None
                if some is None
                else hints_about(some, protocol, ups, bodies, of_clocks=of_clocks),
                None if newest is None else evaluate_rows(newest, protocol, ups),
            )

        if some is not None or newest is not None:
            self._task.start(look)
        return has_revised

    def close(self) -> None:
        """Stop."""
        self._task.close()
