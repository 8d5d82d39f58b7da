"""What evaluated runs make: the Parquet tables of a comparison, group by group."""

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
        run: Which.
        planned_key: Hash of all that it was to be evaluated from; "" of a missing run.
        key: Of its record, another one where a common time span cut it; "" if it has none.
        reason: Why it has none.
        own_coverage: Of the groundtruth's time before the run was cut to a common time span; None
            for what its record says.
    """

    run: PlannedRun
    planned_key: str
    key: str
    reason: str = ""
    own_coverage: float | None = None


@dataclass(frozen=True, eq=False)
class FinishedComparison:
    """All runs of a comparison after their evaluation, wherever that was.

    Attributes:
        title: What a report calls it.
        settings: That the numbers depend on, as `Plan.settings` has them.
        runs: In the order of the tables.
    """

    title: str
    settings: dict[str, Any]
    runs: Sequence[FinishedRun]

    @property
    def state(self) -> str:
        """Hash of what the tables are made from; "" while there is a run that may yet succeed."""
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
        """Return whether the tables in a folder are of these runs."""
        return has_tables(folder) and state_of(folder / RUNS) == self.state

    def write_tables(self, folder: Path, record_of: Callable[[FinishedRun], Record]) -> None:
        """Write `runs.parquet` and `pooled.parquet`; memory holds the runs of one group.

        Args:
            folder: The comparison's.
            record_of: Returns the record of a run that has one.

        Raises:
            InputError: They can't be written.
        """
        with refused_by_disk(f"the folder {folder}"):
            for name in (GATES, GATES_JSON):  # are of tables that will be there no more
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
    """Return whether a folder has both tables, of the same runs, all of which were evaluated."""
    state = state_of(folder / RUNS)
    return bool(state) and state_of(folder / POOLED) == state
