"""The numbers of a results table that gates need, trial by trial."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.results_table import ATE, OK, POOLED, RE, STATISTICS, ResultsTable
from trajeval_ros.exceptions import InputError, SettingsError

Group = tuple[str, str]
Row = Mapping[str, Any]

# Names in a gate and columns of the table. The groundtruth's coverage is that of the whole run,
# before a common time span cuts it.
_COVERAGES = {
    "estimate_coverage": "estimate_coverage",
    "groundtruth_coverage": "own_groundtruth_coverage",
}


@dataclass(frozen=True)
class GateTrials:
    """A number of one algorithm on one sequence, trial by trial.

    Attributes:
        values: One value per trial; inf for a failed run or a run without this number.
        copies: Number of omitted trials: their poses are identical to those of another trial.
        runs: By trial name, copies included: a key that identical poses share, and the value.
    """

    values: list[float]
    copies: int = 0
    runs: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def paired_with(self, now: GateTrials, whose: str) -> tuple[GateTrials, GateTrials]:
        """Return the trials of both tables, paired by trial name.

        Pairs with identical poses count once.

        Args:
            now: Trials of the newer table.
            whose: Algorithm and sequence, for the error message.

        Raises:
            SettingsError: A trial name occurs in only one of the tables.
        """
        for has, lacks, where in (
            (self, now, "this comparison"),
            (now, self, "the baseline"),
        ):
            missing = [repr(name) for name in has.runs if name not in lacks.runs]
            if missing:
                raise SettingsError(
                    f"--paired needs the same trials on both sides, and {where} has no trial "
                    f"{', '.join(missing)} of {whose}; add these trials or remove --paired"
                )
        pairs = {
            (old[0], now.runs[name][0]): (old[1], now.runs[name][1])
            for name, old in self.runs.items()
        }
        copies = len(self.runs) - len(pairs)
        before, after = ([pair[side] for pair in pairs.values()] for side in (0, 1))
        return GateTrials(before, copies), GateTrials(after, copies)


class GateValues:
    """The numbers of a results table, by algorithm, sequence and trial."""

    def __init__(self, rows: ResultsTable) -> None:
        self.settings = rows.settings
        self._table = rows
        self._runs = rows.distinct(
            ("algorithm", "sequence", "trial", "status", "reason", "groundtruth_sha256",
             "estimate_sha256")
        )  # fmt: skip
        self._numbers = rows.distinct(("kind", "metric", "length"))
        self._reasons = {_run(row): row["reason"] for row in self._runs if row["status"] != OK}
        self.groundtruths = {
            (row["algorithm"], row["sequence"]): row["groundtruth_sha256"]
            for row in self._runs
            if row["groundtruth_sha256"]
        }

    @property
    def groups(self) -> list[Group]:
        """All pairs of algorithm and sequence, including those without numbers."""
        return list(dict.fromkeys((row["algorithm"], row["sequence"]) for row in self._runs))

    @property
    def failed(self) -> dict[Group, list[bool]]:
        """Whether runs failed or are missing, by algorithm and sequence."""
        found: dict[Group, dict[str, bool]] = {group: {} for group in self.groups}
        for row in self._runs:
            found[row["algorithm"], row["sequence"]][row["trial"]] = row["status"] != OK
        return {group: list(runs.values()) for group, runs in found.items()}

    def trials(self, path: str) -> dict[Group, GateTrials]:
        """Return the trials of a number by algorithm and sequence; identical runs count once.

        Raises:
            SettingsError: The table has no such number.
        """
        return self.trials_like(path, self)

    def trials_like(self, path: str, other: GateValues) -> dict[Group, GateTrials]:
        """Return the trials of a number that may be missing in this table.

        Args:
            path: Path of the number.
            other: Table in which the path is looked up.

        Raises:
            SettingsError: The other table has no such number.
        """
        rows, column = other.find(path)
        values: dict[Group, dict[str, float]] = {group: {} for group in self.groups}
        hashes: dict[tuple[str, ...], str] = {}
        for row in self._runs:
            values[row["algorithm"], row["sequence"]][row["trial"]] = math.inf
            if row["status"] == OK:
                hashes[_run(row)] = row["estimate_sha256"]
        names = ("algorithm", "sequence", "trial", column)
        for row in self._table.each(names, status=OK, **rows):
            if row[column] is not None:
                values[row["algorithm"], row["sequence"]][row["trial"]] = row[column]
        made = {}
        for group, own in values.items():
            # Failed runs have no hash; they are never copies.
            runs = {trial: (hashes.get((*group, trial)) or trial, x) for trial, x in own.items()}
            distinct = dict(runs.values())
            made[group] = GateTrials(list(distinct.values()), len(own) - len(distinct), runs)
        return made

    def why_failed(self, group: Group) -> str:
        """Return the reason of the first failed run of a group, for a message."""
        reasons = (why for run, why in self._reasons.items() if run[:2] == group and why)
        return next(reasons, "the value is missing")

    def find(self, path: str) -> tuple[dict[str, Sequence[str | None]], str]:
        """Return the rows that a path selects, as allowed values by column, and the value column.

        Raises:
            SettingsError: The table has no such number.
        """
        kind, *rest = path.split(".")
        if kind == "association":
            (column,) = rest if len(rest) == 1 else ("",)
            self._require(column, list(_COVERAGES), path)
            column = _COVERAGES[column]
            return {"kind": [ATE], "metric": ["position_m"]}, column
        self._require(kind, [ATE, "re"], path)
        length: str | None = None
        if kind == "re":
            lengths = [key for row in self._numbers if row["length"] and (key := _key(row))]
            length, *rest = rest or [""]
            self._require(length, [*dict.fromkeys(lengths), "pooled"], path)
            kind, length = (POOLED, None) if length == "pooled" else (RE, length)
        metric, column = rest if len(rest) == 2 else (rest[0] if rest else "", "")
        own = [row for row in self._numbers if row["kind"] == kind and _key(row) == length]
        self._require(
            metric, list(dict.fromkeys(row["metric"] for row in own if row["metric"])), path
        )
        self._require(column, list(STATISTICS), path)
        written = list(dict.fromkeys(row["length"] for row in own))
        return {"kind": [kind], "metric": [metric], "length": written}, column

    @staticmethod
    def _require(name: str, known: list[str], path: str) -> None:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = (
                f"did you mean {near[0]!r}?"
                if near
                else (f"use one of {', '.join(known) or 'none'}")
            )
            raise SettingsError(f"the table has no {name!r} of {path!r}; {hint}")


def require_same_settings(
    baseline: GateValues, now: Mapping[str, Any], gates: Sequence[Gate]
) -> None:
    """Check that the settings of two tables are equal, where the gates depend on them.

    Args:
        baseline: The older table.
        now: Settings of the newer table.
        gates: The gates.

    Raises:
        InputError: A setting differs.
    """
    pooled = any(gate.path.startswith("re.pooled") for gate in gates)
    for name, value in now.items():
        if name == "lengths" and not pooled:  # `GateValues.find` reports a missing length
            continue
        before = baseline.settings.get(name)
        if before != value:
            was, now_is = (
                f"no {name}" if each is None else f"{name} {each}" for each in (before, value)
            )
            raise InputError(
                f"the baseline was made with {was}, and this comparison with {now_is}; repeat "
                "one of them with the same settings"
            )


def remarks_on(baseline: GateValues, now: GateValues) -> list[str]:
    """Return remarks on other differences: a changed groundtruth."""
    changed = dict.fromkeys(
        sequence
        for (algorithm, sequence), before in baseline.groundtruths.items()
        if now.groundtruths.get((algorithm, sequence), before) != before
    )
    if not changed:
        return []
    return [
        f"the groundtruth of {', '.join(changed)} differs from the baseline, so the values are "
        "not comparable"
    ]


def _run(row: Row) -> tuple[str, ...]:
    return row["algorithm"], row["sequence"], row["trial"]


def _key(row: Row) -> str | None:
    """Return a sub-trajectory length in the notation of paths: 8m, 8_5m."""
    length: str | None = row["length"]
    return None if length is None else length.replace(".", "_")
