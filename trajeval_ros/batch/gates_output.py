"""The verdicts of gates: as Markdown for a pull request, and as JSON with all digits.

The schema of the JSON is `trajeval-gates/2`; docs/compare.md describes every field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from trajeval_ros import __version__
from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.gates import (
    FAILED,
    LOST,
    MORE_FAILURES,
    NEW,
    NO_WORSE,
    NOT_ALONE,
    UNDECIDED,
    WORSE,
    Failures,
    GateVerdict,
    Judgement,
    NumberVerdict,
    PooledVerdict,
    Size,
)
from trajeval_ros.batch.permutation_tests import equal_trials
from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.numbers import NOTHING, change_percent, counted, three_decimals
from trajeval_ros.formatting.text_tables import BOLD, MarkedText, TextCell, markdown_table
from trajeval_ros.io.json_file import json_text
from trajeval_ros.report.definitions import ABSOLUTE_LABELS, RELATIVE_LABELS

SCHEMA = "trajeval-gates/2"
_MOST_ROWS = 20  # longer tables are folded
_ORDER = (LOST, WORSE, UNDECIDED, NOT_ALONE, NO_WORSE, NEW, FAILED)
# Verdicts as text; gates.json has the identifiers.
_TEXTS = {UNDECIDED: "inconclusive", LOST: "missing value"}


def to_json(judgement: Judgement, title: str, remarks: Sequence[str]) -> str:
    """Return the verdicts of all gates and numbers as JSON; unknown values are null."""
    failures = judgement.failures
    sides = {side: dict(zip(("failed", "runs"), getattr(failures, side), strict=True))
             for side in ("before", "now")}  # fmt: skip
    content = {
        "schema": SCHEMA,
        "version": __version__,
        "title": title,
        "notes": list(remarks),
        "verdict": judgement.verdict,
        "false_alarms": judgement.false_alarms,
        "gates": [_gate_json(gate) for gate in judgement.gates],
        "failures": _parts(failures, "verdict", "p", "level") | sides,
    }
    return json_text(content, indent=2)


def _gate_json(verdict: GateVerdict) -> dict[str, Any]:
    gate, pooled = verdict.gate, verdict.pooled
    made = {"gate": str(gate), "margin": gate.percent / 100.0, **_parts(gate, "path", "tested")}
    made |= _parts(verdict, "verdict", "paired", "copies")
    names = ("count", "verdict", "change", "bounds", "noticeable", "p", "level", "more_trials")
    made["together"] = None if pooled is None else _parts(pooled, *names)
    made["numbers"] = numbers = []
    for number in verdict.numbers:
        both = zip(("before", "now"), number.medians, number.trials, strict=True)
        sides = {side: {"median": _finite(median), "trials": size} for side, median, size in both}
        numbers_of_group = _parts(
            number, "verdict", "reason", "change", "noticeable", "p", "level"
        )
        algorithm, sequence = number.group
        numbers.append({"algorithm": algorithm, "sequence": sequence, **sides, **numbers_of_group})
    return made


def _parts(whole: object, *names: str) -> dict[str, Any]:
    return {name: _finite(getattr(whole, name)) for name in names}


def _finite(value: Any) -> Any:
    """Return None for inf, the median if half of the trials failed; other values as they are."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_markdown(judgement: Judgement, title: str, remarks: Sequence[str]) -> str:
    """Return the verdicts of all gates and numbers as Markdown."""
    margins = dict.fromkeys(f"{gate.gate.percent:g} %" for gate in judgement.gates)
    head = {
        LOST: "missing values",
        MORE_FAILURES: "more failed runs",
        NO_WORSE: f"no worse than {' and '.join(margins)}",
    }.get(judgement.verdict, _TEXTS.get(judgement.verdict, judgement.verdict))
    lines, level = [f"### {markdown_text(title)}: {head}"], f"{100 * judgement.false_alarms:g} %"
    lines += [f"**Note:** {markdown_text(remark)}." for remark in remarks]
    for gate in judgement.gates:
        lines += _gate(gate, judgement.false_alarms)
    lines.append(_failures(judgement.failures))
    if any(gate.gate.tested for gate in judgement.gates):
        lines.append(
            f"Probability of a false alarm: at most {level} from values, and {level} from failed "
            "runs."
        )
    return "\n\n".join([*lines, ""]).removesuffix("\n")


def _gate(verdict: GateVerdict, level: float) -> list[str]:
    """Return the paragraphs of a gate."""
    gate = verdict.gate
    lines = [f"Gate `{gate}`:"]
    if verdict.pooled is not None:
        lines.append(_pooled(verdict, verdict.pooled, level))
    if not gate.tested:
        lines.append(
            "Untested: only medians are compared. If trials vary, false alarms are possible."
        )
    if verdict.paired:
        lines.append(
            "Paired by trial name: trials of a pair must share the seed, and only the seed."
        )
    if verdict.copies:
        lines.append(f"Identical trials, counted once: {verdict.copies}.")
    ranked = sorted(verdict.numbers, key=lambda number: _ORDER.index(number.verdict))
    shown = ranked if len(ranked) <= _MOST_ROWS else [item for item in ranked if item.fails]
    folded = ranked[len(shown) :]
    if shown:
        lines.append(_table(shown, gate))
    if folded:
        lines += [f"<details><summary>Others: {len(folded)}</summary>", _table(folded, gate)]
        lines.append("</details>")
    return lines


def _pooled(verdict: GateVerdict, pooled: PooledVerdict, level: float) -> str:
    """Return the sentences on all numbers of a gate together."""
    margin, single = f"{verdict.gate.percent:g} %", pooled.count == 1
    word = "inconclusive, margin" if pooled.verdict == UNDECIDED else f"{pooled.verdict} than"
    who = "The single value" if single else f"All {pooled.count} values together"
    bounds = (
        "no bounds" if pooled.bounds is None else " … ".join(map(change_percent, pooled.bounds))
    )
    text = f"**{who}: {word} {margin}**: {change_percent(pooled.change)} ({bounds})."
    tested = (WORSE, NO_WORSE, UNDECIDED, NOT_ALONE)
    sizes = sorted({number.trials for number in verdict.numbers if number.verdict in tested})
    trials = ", ".join(map(_trials, sizes))
    if pooled.more_trials:
        use = counted(equal_trials(pooled.count, level), "trial")
        return (
            f"{text} {trials}: too few trials to decide. A worsening of any size remains "
            f"inconclusive. Use {use} on both sides, or {pooled.more_trials} more per value now."
        )
    size = f"{'' if single else 'common '}worsening of {_size(pooled.noticeable or 0.0)}"
    text += f" {'No worsening' if pooled.noticeable is None else f'A {size}'} is detected in 80 %"
    alone = [number.noticeable for number in verdict.numbers if number.noticeable is not None]
    if single or not alone:
        text += " of comparisons"
    else:
        span = " to ".join(dict.fromkeys([_size(min(alone)), _size(max(alone))]))
        text += f" of comparisons; in a single value, {span}"
    if not single and not verdict.paired and all(number.p is None for number in verdict.numbers):
        enough = counted(equal_trials(1, level / 2.0), "trial")
        text += f". {trials}: too few to test single values; use {enough} on both sides"
    return f"{text}."


def _trials(size: Size) -> str:
    old, new = size
    text = counted(old, "trial")
    return f"{text} on both sides" if old == new else f"{text} in the baseline and {new} now"


def _failures(failures: Failures) -> str:
    (old, of_old), (new, of_new) = failures.before, failures.now
    text = f"Failed runs: {old} of {of_old} in the baseline, {new} of {of_new} now"
    if not old + new:
        return f"{text}."
    is_more = failures.verdict == MORE_FAILURES
    word = f"**{MORE_FAILURES}**" if is_more else "not statistically significant"
    return f"{text} (p = {failures.p:.2g}): {word}."


def _table(numbers: Sequence[NumberVerdict], gate: Gate) -> str:
    metric = gate.path.rpartition(".")[0].rpartition(".")[2]
    label = " [%]" if gate.is_share else {**ABSOLUTE_LABELS, **RELATIVE_LABELS}.get(metric, "")
    unit = "".join(label.partition(" [")[1:])
    values = [f"{side}{unit}" for side in ("old", "new")]
    headings = ["algorithm, sequence", *values, "change", "trials", "detectable", "verdict"]
    return "\n".join(markdown_table(headings, [_row(number, gate) for number in numbers]))


def _row(number: NumberVerdict, gate: Gate) -> list[TextCell]:
    more = f": {number.reason}" if number.reason else ""
    word = _TEXTS.get(number.verdict, number.verdict)
    scale = 100.0 if gate.is_share else 1.0
    return [
        ", ".join(number.group),
        *(three_decimals(None if median is None else scale * median) for median in number.medians),
        NOTHING if number.change is None else change_percent(number.change),
        "{} / {}".format(*number.trials),
        NOTHING if number.noticeable is None else _size(number.noticeable),
        MarkedText(word, BOLD if number.fails else "", more),
    ]


def _size(share: float) -> str:
    return change_percent(share, sign="")
