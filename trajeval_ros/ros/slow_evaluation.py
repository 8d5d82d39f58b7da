"""Slow evaluation of one estimate on a thread: hints, and the errors of its newest path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from trajeval_ros.diagnosis.causes import DISCONTINUITIES
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
from trajeval_ros.ros.background import BackgroundTask
from trajeval_ros.ros.parameter_table import PARAMETERS

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
