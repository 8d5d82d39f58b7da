"""Test of the number of pairs: the alignment removes most of the error of a few pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.enough_pairs import enough_pairs
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.protocol import Protocol


def few_pairs(protocol: Protocol, pairs: Association) -> str:
    """Return the note of the ATE line if there are too few pairs; else ""."""
    count = len(pairs)
    if count >= enough_pairs(protocol.gauge, protocol.align_states):
        return ""
    return f"{counted(count, 'pair')}, too few for an ATE"


def number_of_pairs(
    protocol: Protocol, pairs: Association, truth: Trajectory, estimate: Trajectory
) -> Examined:
    """Test the number of pairs of two trajectories, with advice on how to get more."""
    name, scores = "number of pairs", {"pairs": float(len(pairs))}
    warning = few_pairs(protocol, pairs)
    if not warning:
        return Examined(name, scores)
    if protocol.gauge.has_translation:
        enough = enough_pairs(protocol.gauge, protocol.align_states)
        warning += (
            f": the alignment by {protocol.gauge.value} removes most of the error of fewer than "
            f"{enough} pairs"
        )
    step_s = median(np.diff(truth.stamps)) / NANOSECONDS if len(truth) > 1 else 0.0
    if step_s > pairs.rule.max_gap_s and pairs.rule.method == "linear":
        warning += (
            f"; the groundtruth has {counted(len(truth), 'state')}, {step_s:.1f} s apart "
            f"(median), and the limit for interpolation is {pairs.rule.max_gap_s:g} s: for "
            "surveyed points, use --association groundtruth-stamps"
        )
    elif pairs.rule.method in ("nearest", "rpg", "evo"):
        warning += (
            f"; {len(truth)} groundtruth states and {len(estimate)} estimated states are paired "
            f"within {pairs.rule.max_time_difference_s:g} s: change the limit with "
            "--max-time-difference SECONDS"
        )
    seen = Seen("few_pairs", 1.0, {"said": warning, **scores})
    return Examined(name, scores, (seen,))
