"""Regression gates: is today's table worse than yesterday's, beyond what trials vary anyway?"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.batch.results_table import ATE, OK, POOLED, RE, STATISTICS, ResultsTable
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.report.matrix import markdown_table, markdown_text
from trajeval_ros.report.numbers import number_text

Array = NDArray[np.float64]
Group = tuple[str, str]
Row = Mapping[str, Any]

WORSE, BETTER, NOISE, SAME, LOST, NEW = "worse", "better", "noise", "same", "lost", "new"
FAILED = "failed"
_FAILS = (WORSE, LOST)
_GATE = re.compile(r"\s*([\w.%]+)\s+worse\s+than\s+(.+?)\s*")
_TERM = re.compile(r"(\d+\.?\d*|\.\d+)\s*(%|MAD)")
# Columns by names: a run's coverage is its own, whatever others cut from it.
_COVERAGES = {
    "estimate_coverage": "estimate_coverage",
    "groundtruth_coverage": "own_groundtruth_coverage",
}
_EXAMPLE = "ate.position_m.rmse worse than 5 % + 2 MAD"
_RESAMPLES = 4000
_CHANCE = 0.05  # that noise alone makes any of a gate's numbers worse or better
_FEWEST_TO_RESAMPLE = 10
_EQUAL = 1e-9  # relative: the digits that are promised
_MOST_ROWS = 20  # of a table that isn't folded


@dataclass(frozen=True)
class Gate:
    """How much worse a number may be than in the baseline.

    Attributes:
        path: As in a requirement: `ate.position_m.rmse`, `re.8m.position_percent.mean`,
            `association.groundtruth_coverage`.
        percent: Of the baseline's median over trials.
        deviations: Median absolute deviations of the baseline's trials.
    """

    path: str
    percent: float
    deviations: float

    @classmethod
    def parse(cls, text: str) -> Gate:
        """Read `ate.position_m.rmse worse than 5 % + 2 MAD`.

        Raises:
            SettingsError: It is written otherwise.
        """
        match = _GATE.fullmatch(text)
        terms = [_TERM.fullmatch(each.strip()) for each in match[2].split("+")] if match else []
        sizes: dict[str, float] = {}
        for term in terms:
            if term is None or term[2] in sizes:
                break
            sizes[term[2]] = float(term[1])
        if match is None or len(sizes) != len(terms):
            raise SettingsError(f"can't read the gate {text!r}; write it as {_EXAMPLE!r}")
        return cls(match[1], sizes.get("%", 0.0), sizes.get("MAD", 0.0))

    def __str__(self) -> str:
        """Write it as `parse` reads it."""
        terms = []
        if self.percent or not self.deviations:
            terms.append(f"{self.percent:g} %")
        if self.deviations:
            terms.append(f"{self.deviations:g} MAD")
        return f"{self.path} worse than {' + '.join(terms)}"

    @property
    def larger_is_worse(self) -> bool:
        """Whether it is an error, and not a coverage."""
        return not self.path.startswith("association.")


@dataclass(frozen=True)
class Verdict:
    """What became of a number of one algorithm on one sequence.

    Attributes:
        gate: Which number, and how much worse it may be.
        algorithm, sequence: Whose.
        before, now: Medians over the trials that both have; None without numbers.
        interval: Of their difference, 95 % for all numbers of the gate together; None of less
            than two trials.
        trials: Number of trials that both have.
        verdict: `worse`, `better`, `same`; `noise`: beyond the limit, but within what trials
            vary; `lost`: a run that had a number has none; `new`: without one in the baseline;
            `failed`: without one in either.
        reason: What was lost.
    """

    gate: Gate
    algorithm: str
    sequence: str
    before: float | None
    now: float | None
    interval: tuple[float, float] | None
    trials: int
    verdict: str
    reason: str = ""

    @property
    def fails(self) -> bool:
        """Whether it is a regression."""
        return self.verdict in _FAILS


class GateValues:
    """The numbers of a table, run by run, that gates ask for."""

    def __init__(self, rows: ResultsTable) -> None:
        self.settings = rows.settings
        names = ("algorithm", "sequence", "trial", "status", "reason", "groundtruth_sha256")
        columns = ("kind", "metric", "length", *STATISTICS, *_COVERAGES.values())
        self._rows = rows.select((*names, *columns))
        self.reasons = {_run(row): row["reason"] for row in self._rows if row["status"] != OK}
        self.groundtruths = {
            (row["algorithm"], row["sequence"]): row["groundtruth_sha256"]
            for row in self._rows
            if row["groundtruth_sha256"]
        }

    @property
    def groups(self) -> list[Group]:
        """All algorithms on all sequences, also those without numbers."""
        return list(dict.fromkeys((row["algorithm"], row["sequence"]) for row in self._rows))

    @property
    def runs(self) -> set[tuple[str, ...]]:
        """All algorithms, sequences and trials."""
        return {_run(row) for row in self._rows}

    def of(self, matches: Callable[[Row], bool], column: str) -> dict[Group, dict[str, float]]:
        """Return a number, as `find` has it, by algorithm and sequence, and trial."""
        found: dict[Group, dict[str, float]] = {group: {} for group in self.groups}
        for row in self._rows:
            if row["status"] == OK and matches(row) and row[column] is not None:
                found[row["algorithm"], row["sequence"]][row["trial"]] = row[column]
        return found

    def find(self, path: str) -> tuple[Callable[[Row], bool], str]:
        """Return which rows a path means, and which of their columns.

        Raises:
            SettingsError: The table has no such number.
        """
        kind, *rest = path.split(".")
        if kind == "association":
            (column,) = rest if len(rest) == 1 else ("",)
            self._require(column, list(_COVERAGES), path)
            column = _COVERAGES[column]
            return lambda row: row["kind"] == ATE and row["metric"] == "position_m", column
        self._require(kind, [ATE, "re"], path)
        length: str | None = None
        if kind == "re":
            lengths = [key for row in self._rows if row["length"] and (key := _key(row))]
            length, *rest = rest or [""]
            self._require(length, [*dict.fromkeys(lengths), "pooled"], path)
            kind, length = (POOLED, None) if length == "pooled" else (RE, length)
        metric, column = rest if len(rest) == 2 else (rest[0] if rest else "", "")
        own = [row for row in self._rows if row["kind"] == kind and _key(row) == length]
        self._require(metric, list(dict.fromkeys(row["metric"] for row in own)), path)
        self._require(column, list(STATISTICS), path)
        return (
            lambda row: (row["kind"], _key(row), row["metric"]) == (kind, length, metric),
            column,
        )

    @staticmethod
    def _require(name: str, known: list[str], path: str) -> None:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(known) or 'none'}"
            raise SettingsError(f"the table has no {name!r} of {path!r}; {hint}")


def require_same_settings(
    baseline: GateValues, now: Mapping[str, Any], gates: Sequence[Gate]
) -> None:
    """Check that two tables can be compared, in what the gates ask for.

    Raises:
        InputError: They were made by other definitions.
    """
    pooled = any(gate.path.startswith("re.pooled") for gate in gates)
    for name, value in now.items():
        if name == "lengths" and not pooled:  # one that is lacking is told by itself
            continue
        before = baseline.settings.get(name)
        if before != value:
            was, now_is = (
                f"no {name}" if each is None else f"{name} {each}" for each in (before, value)
            )
            raise InputError(
                f"the baseline was made with {was} and this comparison with {now_is}, so their "
                "numbers don't compare; make one of them anew"
            )


def judge(gates: Sequence[Gate], baseline: GateValues, now: GateValues) -> list[Verdict]:
    """Judge every algorithm on every sequence by every gate.

    Raises:
        SettingsError: A gate asks for a number that the baseline has not.
    """
    verdicts = []
    for gate in gates:
        number = baseline.find(gate.path)
        before, after = baseline.of(*number), now.of(*number)
        groups = dict.fromkeys([*before, *after])
        verdicts += [
            _verdict(gate, group, before.get(group, {}), after.get(group, {}), now, len(groups))
            for group in groups
        ]
    return verdicts


def _verdict(
    gate: Gate,
    group: Group,
    before: dict[str, float],
    now: dict[str, float],
    table: GateValues,
    numbers: int,
) -> Verdict:
    both = [trial for trial in before if trial in now]
    lost = [trial for trial in before if trial not in now]
    paired = both or list(before)
    middle = _median([before[trial] for trial in paired])
    if not before:
        verdict = NEW if now else FAILED
        return Verdict(gate, *group, None, _median(list(now.values())), None, 0, verdict)
    if lost:
        reason = _why_lost(group, lost, table)
        after = _median([now[trial] for trial in both])
        return Verdict(gate, *group, middle, after, None, len(both), LOST, reason)
    x = np.array([before[trial] for trial in both])
    y = np.array([now[trial] for trial in both])
    verdict, interval = _compare(gate, x, y, numbers)
    return Verdict(gate, *group, middle, _median(y.tolist()), interval, len(both), verdict)


def _why_lost(group: Group, lost: Sequence[str], table: GateValues) -> str:
    run = (*group, lost[0])
    why = "it is not in this comparison"
    if run in table.runs:
        why = table.reasons.get(run) or "it has no such number"
    more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
    return f"{f'trial {lost[0]}' if lost[0] else 'the run'}{more}: {why}"


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _compare(
    gate: Gate, before: Array, now: Array, numbers: int
) -> tuple[str, tuple[float, float] | None]:
    """Compare medians over the same trials: beyond the limit, and beyond chance?

    A gate looks at so many numbers that one of them is always far off. So each has a share of the
    chance that is allowed for all (Bonferroni).
    """
    sign = 1.0 if gate.larger_is_worse else -1.0
    middle = float(np.median(before))
    deviation = float(np.median(np.abs(before - middle)))
    limit = abs(middle) * (gate.percent / 100.0 + _EQUAL) + gate.deviations * deviation
    difference = float(np.median(now)) - middle
    interval = paired_interval(before, now, _CHANCE / numbers)
    for direction, verdict in ((sign, WORSE), (-sign, BETTER)):
        if direction * difference > limit:
            if interval is None or min(direction * interval[0], direction * interval[1]) > 0.0:
                return verdict, interval
            return NOISE, interval
    return SAME, interval


def paired_interval(before: Array, now: Array, chance: float) -> tuple[float, float] | None:
    """Return an interval of the difference over paired trials (N,), missed with that chance.

    From ten trials on it is a percentile bootstrap's of the difference of medians; each is drawn
    with both its numbers, so that what both have in common cancels, and the draw is seeded, so
    that the same numbers give the same interval. Of fewer, resampling sees too little of what they
    might have been (of two trials its 95 % are 50 %), so it is Student's of the mean difference.

    Args:
        before: (N,).
        now: (N,), of the same trials.
        chance: That it misses the difference, on either side.

    Returns:
        Its ends; None of less than two trials.
    """
    count = len(before)
    if count < 2:
        return None
    if count < _FEWEST_TO_RESAMPLE:
        from scipy.special import stdtrit

        each = now - before
        reach = float(-stdtrit(count - 1, chance / 2.0) * each.std(ddof=1) / np.sqrt(count))
        return float(each.mean()) - reach, float(each.mean()) + reach
    rows = np.random.default_rng(0).integers(count, size=(_RESAMPLES, count))
    differences = np.median(now[rows], axis=1) - np.median(before[rows], axis=1)
    low, high = np.percentile(differences, (50.0 * chance, 100.0 - 50.0 * chance))
    return float(low), float(high)


def to_markdown(verdicts: Sequence[Verdict], title: str, remarks: Sequence[str]) -> str:
    """Return a summary for a pull request: what is worse first, the rest folded if long."""
    bad = [each for each in verdicts if each.fails]
    head = f"### {markdown_text(title)}: " + (
        f"{len(bad)} regression{'s' if len(bad) > 1 else ''} in {len(verdicts)} numbers"
        if bad
        else f"no regression in {len(verdicts)} numbers"
    )
    gates = "; ".join(dict.fromkeys(f"`{each.gate}`" for each in verdicts))
    lines = [head, "", f"Fails if {gates}.", *(f"**Note:** {each}." for each in remarks), ""]
    order = (LOST, WORSE, BETTER, NOISE, NEW, FAILED, SAME)
    ranked = sorted(verdicts, key=lambda each: order.index(each.verdict))
    shown = ranked if len(ranked) <= _MOST_ROWS else [each for each in ranked if each.fails]
    folded = ranked[len(shown) :]
    if shown:
        lines += [*_table(shown), ""]
    if folded:
        summary = f"<details><summary>{len(folded)} others</summary>"
        lines += [summary, "", *_table(folded), "", "</details>", ""]
    lines += [
        "Medians over trials; the interval is of their paired difference, 95 % for all numbers of "
        "a gate together. *noise*: beyond the limit, but the interval has zero in it.",
        "",
    ]
    return "\n".join(lines)


def _table(verdicts: Sequence[Verdict]) -> list[str]:
    headings = [
        "algorithm, sequence", "number", "baseline", "now", "change", "interval", "trials",
        "verdict",
    ]  # fmt: skip
    rows = []
    for each in verdicts:
        change = interval = "-"
        if each.before is not None and each.now is not None and each.before != 0.0:
            change = f"{100.0 * (each.now - each.before) / abs(each.before):+.1f} %"
        if each.interval is not None:
            interval = " … ".join(f"{value:+.3g}" for value in each.interval)
        mark = f"**{each.verdict}**" if each.fails else each.verdict
        rows.append(
            [
                markdown_text(f"{each.algorithm}, {each.sequence}"),
                f"`{each.gate.path}`",
                "-" if each.before is None else number_text(each.before),
                "-" if each.now is None else number_text(each.now),
                change,
                interval,
                str(each.trials),
                f"{mark} {markdown_text(each.reason)}".strip(),
            ]
        )
    return markdown_table(headings, rows)


def remarks_on(baseline: GateValues, now: GateValues) -> list[str]:
    """Return what else is different."""
    changed = dict.fromkeys(
        sequence
        for (algorithm, sequence), before in baseline.groundtruths.items()
        if now.groundtruths.get((algorithm, sequence), before) != before
    )
    if not changed:
        return []
    return [
        f"the groundtruth of {', '.join(changed)} is not that of the baseline, so numbers there "
        "don't compare"
    ]


def _run(row: Row) -> tuple[str, ...]:
    return row["algorithm"], row["sequence"], row["trial"]


def _key(row: Row) -> str | None:
    """Return a length as paths have it: 8m, 8_5m."""
    length: str | None = row["length"]
    return None if length is None else length.replace(".", "_")
