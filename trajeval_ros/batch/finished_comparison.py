"""The Parquet tables of a comparison, written from its records group by group."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from trajeval_ros.batch.plan import PlannedRun
from trajeval_ros.batch.pooling import pooled_rows, write_pooled
from trajeval_ros.batch.records import Record
from trajeval_ros.batch.results_table import state_of, write_table
from trajeval_ros.batch.run_rows import row_of_failure, rows_of_run
from trajeval_ros.batch.source_hash import hash_of_package
from trajeval_ros.io.writing import refused_by_disk, write_text

RUNS, POOLED = "runs.parquet", "pooled.parquet"
GATES, GATES_JSON = "gates.md", "gates.json"
_ABOUT = "README.txt"
_ABOUT_TEXT = """\
Made by trajeval compare.
runs.parquet    a row per run x metric x length, with inputs and settings
pooled.parquet  statistics over trials, by algorithm and sequence
report.html, tables.*  report and tables; gates.md and gates.json with a
                       baseline
runs/, inputs.json     finished runs, which are not evaluated again
"""


class FinishedRun(NamedTuple):
    """A run after its evaluation.

    Attributes:
        run: The run.
        planned_key: Hash of all inputs of its evaluation; "" for a missing run.
        key: Key of its record, which differs if a common time span cut the run; "" without a
            record.
        reason: Why it has no record.
        own_coverage: Share of the groundtruth's duration that the whole run covers, if a common
            time span cut it; None for the value in its record.
    """

    run: PlannedRun
    planned_key: str
    key: str
    reason: str = ""
    own_coverage: float | None = None


@dataclass(frozen=True, eq=False)
class FinishedComparison:
    """All runs of a comparison after their evaluation.

    Attributes:
        title: Its title.
        settings: Settings that the numbers depend on, as in `Plan.settings`.
        runs: The runs, in the order of the tables.
    """

    title: str
    settings: dict[str, Any]
    runs: Sequence[FinishedRun]

    @property
    def state(self) -> str:
        """Hash of all inputs of the tables; "" if a run failed that may succeed next time."""
        if any(not each.key and not each.run.missing for each in self.runs):
            return ""
        digest = hashlib.sha256(
            json.dumps([hash_of_package(), self.title, self.settings]).encode()
        )
        for each in self.runs:
            run = each.run
            part = (
                run.algorithm, run.sequence, run.trial, run.groundtruth, run.estimate,
                run.missing, each.planned_key,
            )  # fmt: skip
            digest.update(json.dumps(part).encode())
        return digest.hexdigest()

    def is_in(self, folder: Path) -> bool:
        """Return whether the tables in a folder belong to these runs."""
        return has_tables(folder) and state_of(folder / RUNS) == self.state

    def write_tables(self, folder: Path, record_of: Callable[[FinishedRun], Record]) -> None:
        """Write `runs.parquet` and `pooled.parquet`; memory holds the runs of one group.

        Args:
            folder: Folder of the comparison.
            record_of: Returns the record of a run that has one.

        Raises:
            InputError: They can't be written.
        """
        with refused_by_disk(f"the folder {folder}"):
            for name in (GATES, GATES_JSON):  # belong to the previous tables
                (folder / name).unlink(missing_ok=True)
        write_text(folder / _ABOUT, _ABOUT_TEXT)
        pooled: list[dict[str, Any]] = []

        def rows() -> Iterator[dict[str, Any]]:
            groups = groupby(self.runs, lambda each: (each.run.algorithm, each.run.sequence))
            for (algorithm, sequence), group in groups:
                found = []
                count = 0
                for each in group:
                    count += 1
                    if not each.key:
                        yield row_of_failure(each.run, each.reason)
                        continue
                    record = record_of(each)
                    found.append(record)
                    coverage = each.own_coverage
                    if coverage is None:
                        coverage = record.run["association"]["groundtruth_coverage"]
                    yield from rows_of_run(each.run, record, coverage)
                pooled.extend(pooled_rows(algorithm, sequence, count, found))

        state = self.state
        write_table(folder / RUNS, rows(), self.title, self.settings, state)
        write_pooled(folder / POOLED, pooled, self.title, self.settings, state)


def has_tables(folder: Path) -> bool:
    """Return whether a folder has both tables, of the same runs, without failed ones."""
    state = state_of(folder / RUNS)
    return bool(state) and state_of(folder / POOLED) == state
