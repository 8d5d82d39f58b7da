"""The verdicts of gates as Markdown, for a pull request."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.gate_verdicts import (
    ADVISED,
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
)
from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.numbers import NOTHING, change_percent, counted, three_decimals
from trajeval_ros.formatting.text_tables import BOLD, MarkedText, TextCell, markdown_table
from trajeval_ros.report.metric_labels import ABSOLUTE_LABELS, RELATIVE_LABELS

_MOST_ROWS = 20  # longer tables are folded
_ORDER = (LOST, WORSE, UNDECIDED, NOT_ALONE, NO_WORSE, NEW, FAILED)


def to_markdown(judgement: Judgement, title: str, remarks: Sequence[str]) -> str:
    """Return the verdicts of all gates and numbers, with detectable changes, as Markdown.

    Args:
        judgement: The verdicts.
        title: Title of the comparison.
        remarks: Sentences for the start, without a full stop.
    """
    lines = [f"### {markdown_text(title)}: {_head(judgement)}", ""]
    lines += [line for each in remarks for line in (f"**Note:** {markdown_text(each)}.", "")]
    for each in judgement.gates:
        lines += _gate(each, judgement.false_alarms)
    lines += [_failures(judgement.failures), ""]
    if any(each.gate.tested for each in judgement.gates):
        lines += [
            f"Probability of a false alarm: at most {100 * judgement.false_alarms:g} % from "
            f"values, and {100 * judgement.failures.level:g} % from failed runs.",
            "",
        ]
    return "\n".join(lines)


def _head(judgement: Judgement) -> str:
    margins = dict.fromkeys(f"{each.gate.percent:g} %" for each in judgement.gates)
    return {
        LOST: "missing values",
        MORE_FAILURES: "more failed runs",
        NO_WORSE: f"no worse than {' and '.join(margins)}",
    }.get(judgement.verdict) or _word(judgement.verdict)


def _word(verdict: str) -> str:
    """Return the verdict of a value as text; gates.json keeps the identifier."""
    return {UNDECIDED: "inconclusive", LOST: "missing value"}.get(verdict, verdict)


def _gate(verdict: GateVerdict, false_alarms: float) -> list[str]:
    gate = verdict.gate
    lines = [f"Gate `{gate}`:", ""]
    if verdict.pooled is not None:
        lines += [_pooled(verdict, verdict.pooled), ""]
    if verdict.advised is not None:
        lines += [_advice(verdict, verdict.advised), ""]
    if verdict.pooled is not None and verdict.pooled.count == 1:
        (size,) = [each.trials for each in verdict.numbers if each.verdict in _JUDGED]
        if verdict.pooled.noticeable is None and not verdict.paired:
            lines += [
                f"{_trials(size)} of one value: too few for a test. Use {ADVISED[0]} trials in "
                f"the baseline and {ADVISED[1]} in this comparison. If the spread of trials is "
                "known, write 'spread 15 %'. If trials do not vary, write 'untested'.",
                "",
            ]
    for note in _notes(verdict, false_alarms):
        lines += [note, ""]
    ranked = sorted(verdict.numbers, key=lambda each: _ORDER.index(each.verdict))
    shown = ranked if len(ranked) <= _MOST_ROWS else [each for each in ranked if each.fails]
    folded = ranked[len(shown) :]
    if shown:
        lines += [*_table(shown, gate), ""]
    if folded:
        summary = f"<details><summary>Others: {len(folded)}</summary>"
        lines += [summary, "", *_table(folded, gate), "", "</details>", ""]
    return lines


_JUDGED = (WORSE, NO_WORSE, UNDECIDED, NOT_ALONE)


def _notes(verdict: GateVerdict, false_alarms: float) -> list[str]:
    gate, notes = verdict.gate, []
    if not gate.tested:
        notes.append(
            "Untested: only medians are compared. If trials vary, false alarms are possible."
        )
    if verdict.paired:
        notes.append(
            "Paired by trial name: trials of a pair must share the seed, and only the seed."
        )
    if gate.spread_percent is not None:
        notes.append(
            f"The spread of {gate.spread_percent:g} % is given by the user. If trials vary more, "
            f"the probability of a false alarm exceeds {100 * false_alarms:g} %."
        )
    if gate.deviations and gate.tested:
        notes.append(
            f"`+ {gate.deviations:g} MAD` is an additional condition on single values, not part "
            "of the test."
        )
    if verdict.copies:
        notes.append(f"Identical trials, counted once: {verdict.copies}.")
    return notes


def _pooled(verdict: GateVerdict, pooled: PooledVerdict) -> str:
    margin = f"{verdict.gate.percent:g} %"
    said = {
        WORSE: f"worse than {margin}",
        NO_WORSE: f"no worse than {margin}",
        UNDECIDED: f"inconclusive, margin {margin}",
    }[pooled.verdict]
    who = "The single value" if pooled.count == 1 else f"All {pooled.count} values together"
    bounds = "no bounds"
    if pooled.bounds is not None:
        bounds = " … ".join(map(change_percent, pooled.bounds))
    text = f"**{who}: {said}**: {change_percent(pooled.change)} ({bounds})."
    if verdict.paired:
        return f"{text} The detectable worsening is not known for pairs."
    if pooled.noticeable is None:
        return f"{text} No worsening of any size is detectable."
    size = "worsening" if pooled.count == 1 else "common worsening"
    text += f" A {size} of {_size(pooled.noticeable)} is detected in 80 %"
    alone = [each.noticeable for each in verdict.numbers if each.noticeable is not None]
    if pooled.count == 1 or not alone:
        return f"{text} of comparisons."
    least, most = _size(min(alone)), _size(max(alone))
    span = least if least == most else f"{least} to {most}"
    return f"{text} of comparisons; in a single value, {span}."


def _advice(verdict: GateVerdict, advised: tuple[float, float, float]) -> str:
    sizes = dict.fromkeys(each.trials for each in verdict.numbers if each.verdict in _JUDGED)
    together, least, most = map(_size, advised)
    span = least if least == most else f"{least} to {most}"
    return (
        f"{', '.join(map(_trials, sizes))}: too few to test single values. With {ADVISED[0]} "
        f"trials in the baseline and {ADVISED[1]} here, a common worsening of {together} is "
        f"detectable, and in a single value {span}."
    )


def _trials(size: tuple[int, int]) -> str:
    old, new = size
    if old == new:
        return f"{counted(old, 'trial')} on both sides"
    return f"{counted(old, 'trial')} in the baseline and {new} now"


def _failures(failures: Failures) -> str:
    (old, of_old), (new, of_new) = failures.before, failures.now
    text = f"Failed runs: {old} of {of_old} in the baseline, {new} of {of_new} now"
    if not old + new:
        return f"{text}."
    word = f"**{MORE_FAILURES}**" if failures.fails else "not statistically significant"
    return f"{text} (p = {failures.p:.2g}): {word}."


def _table(numbers: Sequence[NumberVerdict], gate: Gate) -> list[str]:
    values = [f"{side}{_unit(gate)}" for side in ("old", "new")]
    headings = ["algorithm, sequence", *values, "change", "trials", "detectable", "verdict"]
    return markdown_table(headings, [_row(each, gate) for each in numbers])


def _unit(gate: Gate) -> str:
    """Return the unit of a gate's values in brackets, as in the tables; "" for none."""
    if gate.is_share:
        return " [%]"
    metric = gate.path.rpartition(".")[0].rpartition(".")[2]
    _, bracket, unit = {**ABSOLUTE_LABELS, **RELATIVE_LABELS}.get(metric, "").partition(" [")
    return bracket + unit


def _row(number: NumberVerdict, gate: Gate) -> list[TextCell]:
    more = f": {number.reason}" if number.reason else ""
    return [
        f"{number.algorithm}, {number.sequence}",
        *(_value(each, gate) for each in (number.before, number.now)),
        NOTHING if number.change is None else change_percent(number.change),
        "{} / {}".format(*number.trials),
        NOTHING if number.noticeable is None else _size(number.noticeable),
        MarkedText(_word(number.verdict), BOLD if number.fails else "", more),
    ]


def _value(value: float | None, gate: Gate) -> str:
    return three_decimals(100.0 * value if gate.is_share and value is not None else value)


def _size(share: float) -> str:
    return change_percent(share, sign="")
