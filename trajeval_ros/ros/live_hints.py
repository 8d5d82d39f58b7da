"""The diagnosis of a live run, with the names of the node's parameters."""

from __future__ import annotations

import re
from dataclasses import replace

from trajeval_ros.diagnosis.evaluation_diagnosis import diagnose_evaluation
from trajeval_ros.diagnosis.warnings import about_frames
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.online.rows_evaluation import evaluate_rows
from trajeval_ros.online.state_rows import Pairs
from trajeval_ros.ros.parameter_table import PARAMETERS

_OPTION = re.compile(r"--([a-z]+(?:-[a-z]+)*)(?:[ =](?=[\w.+-]))?")
_PARAMETERS = {each.name for each in PARAMETERS}
_CLOCKS = {"clock_offset", "clock_drift", "small_clock_offset"}
# Tests that need all messages. The trail contains only some of the pairs.
_NOT_BY_SOME_PAIRS = {
    "few_pairs", "keyframes", "stamps_rounded", "duplicated", "truth_held", "truth_frozen",
    "truth_bridged", "gap_bridged", "restart",
}  # fmt: skip
# From this duration on, clocks that differ by 37 s (TAI and UTC) have half of the motion in
# common.
_OTHER_RUN_FROM_S = 75.0


def hints_about(
    pairs: Pairs,
    protocol: Protocol,
    ups: tuple[UpAxis, UpAxis],
    bodies: tuple[str, str],
    *,
    of_clocks: bool,
) -> list[Notice]:
    """Return the mistakes that are found in pairs, and differences of frames.

    Args:
        pairs: Some pairs of the run, in the frames of the messages.
        protocol: Settings of the evaluation.
        ups: The up axes of groundtruth and estimate.
        bodies: Names of the bodies of groundtruth and estimate.
        of_clocks: Whether to test the clocks.
    """
    found = [("frames", text) for text in about_frames(*bodies)]
    plain = replace(protocol, lengths=(), align_states=None, align_with="positions")
    evaluation = evaluate_rows(pairs, plain, ups)
    if evaluation is not None:
        sides = evaluation.groundtruth, evaluation.estimate
        left_out = _NOT_BY_SOME_PAIRS if of_clocks else _NOT_BY_SOME_PAIRS | _CLOCKS
        if evaluation.estimate.duration_s < _OTHER_RUN_FROM_S:
            left_out = left_out | {"other_run"}
        found += [
            (each.cause, each.text)
            for each in diagnose_evaluation(evaluation, *sides, paired=True).findings
            if each.cause not in left_out
        ]
    return [Notice("hint", WARN, in_parameters(text), subject) for subject, text in found]


def in_parameters(text: str) -> str:
    """Return a sentence with options as parameters, `hand_eye:=auto`, if they exist.

    Other options are unchanged: they belong to `trajeval evaluate` and `trajeval finish`.
    """

    def parameter(option: re.Match[str]) -> str:
        name = option[1].replace("-", "_")
        if name not in _PARAMETERS:
            return option[0]
        return f"{name}:=" if option[0][-1] in " =" else name

    return _OPTION.sub(parameter, text)
