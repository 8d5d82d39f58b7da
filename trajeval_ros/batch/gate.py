"""A regression gate: a limit of how much worse a number may be, its notation and its numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trajeval_ros.batch.results_table import (
    ATE,
    AVAILABLE,
    OK,
    POOLED,
    RE,
    STATISTICS,
    ResultsTable,
)
from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.geometry.arrays import Floats

_SIZE = r"(\d+\.?\d*|\.\d+)"
_GATE = re.compile(rf"\s*([\w.%]+)\s+worse\s+than\s+{_SIZE}\s*%(\s+untested)?\s*")
_REMOVED = re.compile(r"worse\s+than\b.*(\d\s*MAD|\s+spread\s)")
_OTHER_SPAN = 0.01  # relative difference of common time spans that is stated
_EQUAL = 1e-9  # relative: numbers that differ by less are equal


Group = tuple[str, str]
Row = Mapping[str, Any]
# Names in a gate and columns of the table. The groundtruth's coverage is that of the whole run,
# before a common time span cuts it.
_COVERAGES = {
    "estimate_coverage": "estimate_coverage",
    "groundtruth_coverage": "own_groundtruth_coverage",
}


@dataclass(frozen=True)
class Gate:
    """A limit of how much worse a number may be than in the baseline."""

    path: str  # as in a requirement: `ate.position_m.rmse`, `association.groundtruth_coverage`
    percent: float  # the margin: the largest permitted worsening
    tested: bool = True  # if not, medians are compared

    @classmethod
    def parse(cls, text: str) -> Gate:
        """Parse `ate.position_m.rmse worse than 5 %`; `untested` may follow."""
        match = _GATE.fullmatch(text)
        if match is None and _REMOVED.search(text):
            raise SettingsError(
                f"the gate {text!r} has a condition without an exact test, 'spread' or 'MAD'; "
                "remove it: 6 sequences or 4 trials on both sides need no such condition"
            )
        if match is None:
            raise SettingsError(
                f"the gate {text!r} is not valid; write it as in 'ate.position_m.rmse worse than "
                "5 %'"
            )
        made = cls(match[1], float(match[2]), not match[3])
        if made.is_share and made.percent >= 100.0:
            raise SettingsError(f"the margin of a coverage must be below 100 %, not {text!r}")
        return made

    def __str__(self) -> str:
        return f"{self.path} worse than {self.percent:g} %{'' if self.tested else ' untested'}"

    @property
    def is_share(self) -> bool:
        """Whether the number is a coverage, from 0 to 1, which is worse if it is smaller."""
        return self.path.startswith("association.")

    @property
    def margin(self) -> float:
        """The margin as a difference of `logarithms`, larger by the tolerance of equal numbers."""
        share = self.percent / 100.0
        return _EQUAL + (-math.log1p(-share) if self.is_share else math.log1p(share))

    def logarithms(self, values: Sequence[float]) -> Floats:
        """Return logarithms of all runs of a sequence, larger is worse; NaN for failed runs (inf).

        Zeros count as the smallest positive value: the logarithms must be finite.
        """
        numbers = np.array(values, dtype=np.float64)
        positive = numbers[np.isfinite(numbers) & (numbers > 0.0)]
        least = positive.min() if len(positive) else 1.0
        made = np.log(np.where(np.isfinite(numbers), np.maximum(numbers, least), np.nan))
        return -made if self.is_share else made

    def change(self, logarithm: float) -> float:
        """Convert a change of `logarithms` to a relative change of the number, 0.05 for 5 %."""
        exponent = -logarithm if self.is_share else logarithm
        return math.expm1(exponent) if exponent < 700.0 else math.inf


@dataclass(frozen=True)
class GateTrials:
    """A number of one algorithm on one sequence, trial by trial."""

    # By trial name: a key that identical poses share, and the value; inf for a failed run or a run
    # without this number.
    runs: Mapping[str, tuple[Hashable, float]] = field(default_factory=dict)
    why_failed: str = "the value is missing"  # reason of the first failed run, for a message

    @property
    def values(self) -> list[float]:
        """The values of distinct poses."""
        return list(dict(self.runs.values()).values())

    @property
    def copies(self) -> int:
        """The number of omitted trials: their poses are identical to those of another trial."""
        return len(self.runs) - len(self.values)

    def paired_with(self, now: GateTrials, whose: str) -> tuple[GateTrials, GateTrials]:
        """Return the trials of both tables, paired by trial name.

        Pairs with identical poses count once. `whose` names algorithm and sequence.
        """
        for has, lacks, where in ((self, now, "this comparison"), (now, self, "the baseline")):
            if missing := [repr(name) for name in has.runs if name not in lacks.runs]:
                raise SettingsError(
                    f"--paired needs the same trials on both sides, and {where} has no trial "
                    f"{', '.join(missing)} of {whose}; add these trials or remove --paired"
                )
        both = {name: (old[0], now.runs[name][0]) for name, old in self.runs.items()}
        before, after = (
            GateTrials({name: (key, side.runs[name][1]) for name, key in both.items()})
            for side in (self, now)
        )
        return before, after


class GateValues:
    """The numbers of a results table, by algorithm, sequence and trial."""

    def __init__(self, rows: ResultsTable) -> None:
        self.settings = rows.settings
        self._table = rows
        self._runs = rows.distinct(
            ("algorithm", "sequence", "trial", "status", "reason", "groundtruth_sha256",
             "estimate_sha256", "span_s")
        )  # fmt: skip
        self._numbers = rows.distinct(("kind", "metric", "length"))
        self.groundtruths = {
            (row["algorithm"], row["sequence"]): row["groundtruth_sha256"]
            for row in self._runs
            if row["groundtruth_sha256"]
        }
        self.spans_s: dict[str, float] = {}  # longest one of every sequence
        for row in self._runs:
            longest_s = self.spans_s.get(row["sequence"], 0.0)
            self.spans_s[row["sequence"]] = max(longest_s, row["span_s"] or 0.0)

    def _by_trial(self, value: Callable[[Row], Any]) -> dict[Group, dict[str, Any]]:
        """Return a value of every run, by algorithm and sequence, and by trial."""
        made: dict[Group, dict[str, Any]] = {}
        for row in self._runs:
            made.setdefault((row["algorithm"], row["sequence"]), {})[row["trial"]] = value(row)
        return made

    @property
    def failed(self) -> dict[Group, list[bool]]:
        """Whether runs failed or are missing, by algorithm and sequence."""
        failures = self._by_trial(lambda row: row["status"] != OK)
        return {group: list(runs.values()) for group, runs in failures.items()}

    def trials(self, path: str, baseline: GateValues) -> dict[Group, GateTrials]:
        """Return the trials of a number by algorithm and sequence; identical runs count once."""
        rows, column = baseline.find(path)
        # Failed runs are never copies.
        runs = self._by_trial(
            lambda row: (
                (row["status"] == OK and row["estimate_sha256"]) or row["trial"],
                math.inf,
            )
        )
        names = ("algorithm", "sequence", "trial", column)
        for row in self._table.rows(names, status=OK, **rows):
            if row[column] is not None:
                trials = runs[row["algorithm"], row["sequence"]]
                trials[row["trial"]] = trials[row["trial"]][0], row[column]
        reasons = self._by_trial(lambda row: row["status"] != OK and row["reason"])
        return {
            group: GateTrials(trials, *list(filter(None, reasons[group].values()))[:1])
            for group, trials in runs.items()
        }

    def find(self, path: str) -> tuple[dict[str, Sequence[str | None]], str]:
        """Return the rows that a path selects, as allowed values by column, and its column."""
        (kind, *rest), what = path.split("."), f"part of {path}:"
        if kind == "association":
            require_one_of(column := ".".join(rest), _COVERAGES, what)
            return {"kind": [ATE], "metric": ["position_m"]}, _COVERAGES[column]
        require_one_of(kind, [ATE, AVAILABLE, "re"], what)
        length: str | None = None
        if kind == "re":
            lengths = [key for row in self._numbers if row["length"] and (key := _key(row))]
            length, *rest = rest or [""]
            require_one_of(length, [*dict.fromkeys(lengths), "pooled"], what)
            kind, length = (POOLED, None) if length == "pooled" else (RE, length)
        metric, column = rest if len(rest) == 2 else (rest[0] if rest else "", "")
        rows_of_kind = [
            row for row in self._numbers if row["kind"] == kind and _key(row) == length
        ]
        metrics = dict.fromkeys(row["metric"] for row in rows_of_kind if row["metric"])
        require_one_of(metric, metrics, what)
        require_one_of(column, STATISTICS, what)
        written = list(dict.fromkeys(row["length"] for row in rows_of_kind))
        return {"kind": [kind], "metric": [metric], "length": written}, column


def require_same_settings(
    baseline: GateValues, now: Mapping[str, Any], gates: Sequence[Gate]
) -> None:
    """Refuse settings that differ from the baseline's, where the gates depend on them."""
    pooled = any(gate.path.startswith("re.pooled") for gate in gates)
    for name, value in now.items():
        if name == "lengths" and not pooled:  # `GateValues.find` reports a missing length
            continue
        before = baseline.settings.get(name)
        if before != value:
            was, is_now = ((f"{name} {x}", f"no {name}")[x is None] for x in (before, value))
            raise InputError(
                f"the baseline was made with {was}, and this comparison with {is_now}; repeat "
                "one of them with the same settings"
            )


def remarks_on(baseline: GateValues, now: GateValues) -> list[str]:
    """Return remarks on other differences: of the groundtruth, and of the common time span."""
    before = baseline.groundtruths
    changed = [
        group
        for group, sources in before.items()
        if now.groundtruths.get(group, sources) != sources
    ]
    sequences = {"groundtruth": [sequence for _, sequence in changed]}
    if now.settings.get("common_time_span"):  # which other algorithms and trials shorten
        sequences["common time span"] = [
            sequence
            for sequence, span_s in now.spans_s.items()
            if abs(span_s - baseline.spans_s.get(sequence, span_s)) > _OTHER_SPAN * span_s
        ]
    return [
        f"the {what} of {', '.join(dict.fromkeys(names))} differs from the baseline, so values "
        "are not comparable"
        for what, names in sequences.items()
        if names
    ]


def _key(row: Row) -> str | None:
    """Return a sub-trajectory length in the notation of paths: 8m, 8_5m."""
    length: str | None = row["length"]
    return None if length is None else length.replace(".", "_")
