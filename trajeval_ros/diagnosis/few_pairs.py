"""An ATE from a few pairs, such as surveyed points, of which the alignment takes most out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.enough_pairs import enough_pairs

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation


def few_pairs(evaluation: Evaluation) -> str:
    """Return that there are too few pairs, for the line that gives the ATE; else nothing."""
    protocol, count = evaluation.protocol, len(evaluation.association)
    enough = enough_pairs(protocol.gauge, protocol.align_states)
    if count >= enough:
        return ""
    return f"{count} {'pair is' if count == 1 else 'pairs are'} too few for an ATE"


def about_few_pairs(evaluation: Evaluation) -> list[str]:
    """Return the warning about too few pairs, with what may give more."""
    said = few_pairs(evaluation)
    if not said:
        return []
    protocol, pairs, truth = evaluation.protocol, evaluation.association, evaluation.groundtruth
    enough = enough_pairs(protocol.gauge, protocol.align_states)
    warning = said
    if protocol.gauge.has_translation:
        warning += (
            f": with fewer than {enough}, the alignment by {protocol.gauge.value} takes out most "
            "of what it should show"
        )
    step_s = float(np.median(np.diff(truth.stamps))) / NANOSECONDS if len(truth) > 1 else 0.0
    if step_s > pairs.rule.max_gap_s and pairs.rule.method == "linear":
        warning += (
            f"; the groundtruth's {len(truth)} states are {step_s:.1f} s apart "
            f"(median) and nothing is interpolated across more than {pairs.rule.max_gap_s:g} s: "
            "pair surveyed points by --association nearest --max-time-difference SECONDS"
        )
    elif pairs.rule.method not in ("linear", "continuous", "index"):
        warning += (
            f"; {len(truth)} groundtruth states and {len(evaluation.estimate)} estimated ones are "
            f"paired within {pairs.rule.max_time_difference_s:g} s: --max-time-difference SECONDS "
            "sets another limit"
        )
    return [warning]
