"""Computations that are too slow for a tick, on threads with limited CPU time.

Those of one estimate are hints, and the errors of its newest path.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from trajeval_ros.diagnosis.causes import DISCONTINUITIES
from trajeval_ros.exceptions import describe_defect
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.io.requests.request_from import in_names_of_settings
from trajeval_ros.metrics.discontinuities.events import Loss
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.whole_run import RevisedPath, ThinnedRun, association_of, evaluation_of
from trajeval_ros.pipeline.diagnosing import diagnose
from trajeval_ros.pipeline.input_remarks import about_frames
from trajeval_ros.pipeline.request import Request
from trajeval_ros.ros.parameter_table import PARAMETERS

Result = TypeVar("Result")
PARAMETER_NAMES = {parameter.name for parameter in PARAMETERS}
_CLOCKS = {"clock_offset", "clock_drift", "small_clock_offset"}
# Tests that need all messages. The thinned contains only some of the pairs.
_NOT_BY_SOME_PAIRS = {
    "few_pairs", "frames_lost", "keyframes", "stamps_rounded", "duplicated", "groundtruth_held",
    "groundtruth_frozen", "groundtruth_bridged", "gap_bridged",
    # The evaluator reports these from all pairs and messages.
    "frozen", "frozen_at_start", "diverged", "diverged_at_start", *DISCONTINUITIES,
}  # fmt: skip
# From this duration on, clocks that differ by 37 s (TAI and UTC) have half of the motion in
# common.
_OTHER_RUN_FROM_S = 75.0


class BackgroundTask(Generic[Result]):
    """Runs one computation at a time on its own thread.

    An exception ends the computation, but not the node: it has no result, and `trouble` is set.
    """

    def __init__(self, most_share: float) -> None:
        self.trouble = ""  # why the newest computation has failed; empty if it has not
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._share = most_share
        self._running: Future[tuple[Result | None, str, float]] | None = None
        self._next_at = 0.0

    @property
    def is_due(self) -> bool:
        """Whether a computation may be started now."""
        return self._running is None and time.monotonic() >= self._next_at

    def start(self, compute: Callable[[], Result]) -> None:
        """Start a computation. It must not use data that other threads change."""

        def guarded() -> tuple[Result | None, str, float]:
            begin, result, trouble = time.thread_time(), None, ""
            try:
                result = compute()
            except Exception as error:
                trouble = describe_defect(error)
            return result, trouble, time.thread_time() - begin

        self._running = self._threads.submit(guarded)

    def take(self) -> Result | None:
        """Return the result of a finished computation; None if there is none."""
        return self.wait() if self._running is not None and self._running.done() else None

    def wait(self) -> Result | None:
        """Wait for the running computation and return its result; None if there is none."""
        if self._running is None:
            return None
        (result, self.trouble, took_s), self._running = self._running.result(), None
        self._next_at = time.monotonic() + took_s / self._share
        return result

    def close(self) -> None:
        """Stop the thread after the running computation, without waiting for it."""
        self._threads.shutdown(wait=False)


def hints_about(
    pairs: PairedStates,
    protocol: Protocol,
    bodies: tuple[str, str],
    losses: Sequence[Loss],
    *,
    of_clocks: bool,
) -> list[Remark]:
    """Return the mistakes that are found in pairs without losses, and differences of frames."""
    texts = [("frames", remark.text) for remark in about_frames(*bodies)]
    plain = replace(protocol, lengths=(), align_states=None, align_with="positions")
    if len(pairs):
        some = association_of(pairs, plain)
        left_out = _NOT_BY_SOME_PAIRS if of_clocks else _NOT_BY_SOME_PAIRS | _CLOCKS
        if some.estimate.duration_s < _OTHER_RUN_FROM_S:
            left_out = left_out | {"other_run"}
        diagnosis, _ = diagnose(some.groundtruth, some.estimate, Request(plain), some, losses)
        texts += [
            (finding.cause, finding.text)
            for finding in diagnosis.findings
            if finding.cause not in left_out
        ]
    return [
        warning("hint", in_names_of_settings(text, ":=", PARAMETER_NAMES), subject)
        for subject, text in texts
    ]


_MOST_SHARE = 0.03  # largest share of a core
# Span of the run before the first hints, and factor of its growth before the next ones.
FIRST_HINTS_S = 5.0
_GROWTH = 1.3


@dataclass(frozen=True, eq=False)
class _Findings:
    hints: list[Remark] | None
    revised: Evaluation | None


class SlowEvaluation:
    """Runs evaluations that are too slow for a tick, repeatedly."""

    def __init__(self) -> None:
        self.hints: list[Remark] = []  # newest hints
        self.revised: Evaluation | None = None  # of the newest path
        self._task: BackgroundTask[_Findings] = BackgroundTask(_MOST_SHARE)
        self._hints_at_s = FIRST_HINTS_S
        self._version = 0  # version of the evaluated path

    def renew(
        self,
        thinned: ThinnedRun,
        path: RevisedPath | None,
        protocol: Protocol,
        bodies: tuple[str, str],
        losses: Sequence[Loss],
        *,
        of_clocks: bool,
    ) -> bool:
        """Collect results, and start again if due; return whether a path was evaluated."""
        result = self._task.take()
        if result is not None:
            self.hints = self.hints if result.hints is None else result.hints
            self.revised = result.revised or self.revised
        if self._task.trouble:
            text = f"no test for mistakes: it has failed ({self._task.trouble}); report the defect"
            self.hints = [warning("hint", text, "diagnosis")]
        has_revised = result is not None and result.revised is not None
        if not self._task.is_due:
            return has_revised
        some = newest = None
        if thinned.span_s >= self._hints_at_s:
            self._hints_at_s = _GROWTH * thinned.span_s
            some = thinned.pairs()
        if path is not None and path.version != self._version:
            newest, self._version = path.pairs(), path.version

        def look() -> _Findings:
            return _Findings(
                None
                if some is None
                else hints_about(some, protocol, bodies, losses, of_clocks=of_clocks),
                None if newest is None else evaluation_of(newest, protocol),
            )

        if some is not None or newest is not None:
            self._task.start(look)
        return has_revised

    def close(self) -> None:
        """Stop."""
        self._task.close()
