"""A comparison from its plan to its tables, which goes on where it was interrupted."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, groupby
from pathlib import Path
from typing import Any

from trajeval_ros.batch.executors import Outcome, Pool, evaluate_all
from trajeval_ros.batch.fingerprints import Fingerprints
from trajeval_ros.batch.plan import Plan, PlannedRun
from trajeval_ros.batch.pooling import pooled_rows, write_pooled
from trajeval_ros.batch.records import Record, has_record, read_record, write_record
from trajeval_ros.batch.results_table import (
    load_pyarrow,
    row_of_failure,
    rows_of_run,
    settings_of,
    state_of,
    write_table,
)
from trajeval_ros.batch.source_hash import hash_of_package
from trajeval_ros.batch.worker import Task, work
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.io.writing import refused_by_disk, write_text

RUNS, POOLED, RECORDS = "runs.parquet", "pooled.parquet", "runs"
GATES, GATES_JSON = "gates.md", "gates.json"
_INPUTS, _ABOUT = "inputs.json", "README.txt"
_ABOUT_TEXT = """\
Made by trajeval compare.
runs.parquet    a row per run x metric x length, with what each number depends on
pooled.parquet  statistics over trials, by algorithm and sequence
report.html, tables.*  the same for people; gates.md and gates.json, if there was a
                       baseline
runs/, inputs.json     finished runs: kept, they needn't be evaluated again
"""


@dataclass
class Progress:
    """How far a comparison is.

    Attributes:
        total: Runs that there are, twice with a common time span.
        kept: Runs that were finished before.
        done: Runs that were evaluated.
        new: Runs that were evaluated, once each.
        failed: Runs that could not be.
        running: Names of those being evaluated.
    """

    total: int = 0
    kept: int = 0
    done: int = 0
    new: int = 0
    failed: int = 0
    running: list[str] = field(default_factory=list)


def run_plan(
    plan: Plan,
    folder: Path,
    start_pool: Callable[[], Pool],
    tell: Callable[[Progress], None] = lambda progress: None,
) -> Progress:
    """Evaluate what is not evaluated yet, and write the tables.

    Args:
        plan: What is compared.
        folder: For records and tables; made if it doesn't exist.
        start_pool: Called if there is something to evaluate.
        tell: Called whenever something began or ended.

    Raises:
        InputError: The folder can't be written, or a cluster can't be reached; what is finished
            stays.
    """
    load_pyarrow()
    records = folder / RECORDS
    with refused_by_disk(f"the folder {records}"):
        records.mkdir(parents=True, exist_ok=True)
    batch = _RunningComparison(plan, records, Fingerprints(folder / _INPUTS), start_pool, tell)
    written = {state_of(folder / each) for each in (RUNS, POOLED)}
    if "" not in written:
        tasks = list(batch.planned())
        if written == {batch.state}:
            batch.progress.kept = len(tasks)
            tell(batch.progress)
            return batch.progress
    with refused_by_disk(f"the folder {folder}"):
        for name in (GATES, GATES_JSON):  # are of tables that will be there no more
            (folder / name).unlink(missing_ok=True)
    write_text(folder / _ABOUT, _ABOUT_TEXT)
    batch.evaluate(batch.planned())
    state = batch.state
    if plan.common_time_span:
        batch.cut_to_common_spans()
    _write_tables(folder, batch, state)
    return batch.progress


class _RunningComparison:
    """The runs of one comparison: what is to be done, and why what failed did."""

    def __init__(
        self,
        plan: Plan,
        records: Path,
        fingerprints: Fingerprints,
        start_pool: Callable[[], Pool],
        tell: Callable[[Progress], None],
    ) -> None:
        self.plan = plan
        self.records = records
        self.progress = Progress(total=sum(not run.missing for run in plan.runs))
        self.failures: dict[PlannedRun, str] = {}
        self.tasks: dict[PlannedRun, Task] = {}
        self.own_coverage: dict[PlannedRun, float] = {}
        self._evaluated: set[PlannedRun] = set()
        self._fingerprints = fingerprints
        self._start_pool = start_pool
        self._tell = tell

    def planned(self) -> Iterator[Task]:
        """Yield the runs that there are, as their inputs are read.

        The trials of a sequence follow one another: workers keep its groundtruth.
        """
        for run in sorted(self.plan.runs, key=lambda run: (run.sequence, run.groundtruth)):
            if run.missing:
                self.failures[run] = run.missing
            elif run not in self.tasks and run not in self.failures:
                try:
                    of = self._fingerprints.of
                    inputs = (of(run.groundtruth), of(run.estimate))
                    self.tasks[run] = Task(run, self.plan.request, inputs)
                except TrajevalError as error:
                    self._fail(run, str(error))
            if run in self.tasks:
                yield self.tasks[run]
        self._fingerprints.save()

    @property
    def state(self) -> str:
        """Hash of what the tables are made from; "" while there is a run that may yet succeed."""
        if self.progress.failed:
            return ""
        parts = [
            [run.algorithm, run.sequence, run.trial, run.groundtruth, run.estimate, run.missing]
            + [self.tasks[run].key if run in self.tasks else ""]
            for run in self.plan.runs
        ]
        text = json.dumps([hash_of_package(), self.plan.title, settings_of(self.plan), parts])
        return hashlib.sha256(text.encode()).hexdigest()

    def evaluate(self, tasks: Iterable[Task]) -> None:
        """Evaluate the runs that have no record yet."""
        todo = self._without_record(tasks)
        first = next(todo, None)
        if first is not None:
            evaluate_all(self._start_pool(), chain([first], todo), self._finish, self._watch)
        self.progress.running = []
        self._tell(self.progress)

    def _without_record(self, tasks: Iterable[Task]) -> Iterator[Task]:
        for task in tasks:
            if has_record(self.records, task.key):
                self.progress.kept += 1
                self._tell(self.progress)
            else:
                yield task

    def cut_to_common_spans(self) -> None:
        """Evaluate the runs of each sequence again, over the time that all of them have."""
        spans: dict[str, list[tuple[int, int]]] = defaultdict(list)
        for run, task in self.tasks.items():
            record = self.record(task)
            if record is not None:
                spans[run.sequence].append(record.span_ns)
                self.own_coverage[run] = record.run["association"]["groundtruth_coverage"]
        cut = {}
        for run, task in self.tasks.items():
            if run in self.failures:
                continue
            starts, ends = zip(*spans[run.sequence], strict=True)
            span = (max(starts), min(ends))
            if span[0] >= span[1]:
                self._fail(run, f"the runs of {run.sequence} have no time in common")
            else:
                request = dataclasses.replace(task.request, span_ns=span)
                cut[run] = Task(run, request, task.inputs)
        self.tasks = cut
        self.progress.total += len(cut)
        self.evaluate(cut.values())

    def record(self, task: Task) -> Record | None:
        """Return what a run left; one that can't be read any more is evaluated again."""
        if task.run in self.failures:
            return None
        record = read_record(self.records, task.key)
        if record is None:
            self._finish(task, work(task))
            record = read_record(self.records, task.key)
        return record

    def _finish(self, task: Task, outcome: Outcome) -> None:
        if isinstance(outcome, str):
            self._fail(task.run, outcome)
        else:
            write_record(self.records, task.key, outcome)
            self.progress.done += 1
            self._evaluated.add(task.run)
            self.progress.new = len(self._evaluated)
        self._tell(self.progress)

    def _fail(self, run: PlannedRun, reason: str) -> None:
        self.failures[run] = reason
        self.progress.failed += 1

    def _watch(self, running: list[Task]) -> None:
        self.progress.running = [task.run.name for task in running]
        self._tell(self.progress)


def _write_tables(folder: Path, batch: _RunningComparison, state: str) -> None:
    pooled: list[dict[str, Any]] = []

    def rows() -> Iterator[dict[str, Any]]:
        groups = groupby(batch.plan.runs, key=lambda run: (run.algorithm, run.sequence))
        for (algorithm, sequence), group in groups:
            runs, records = list(group), []
            for run in runs:
                record = batch.record(batch.tasks[run]) if run in batch.tasks else None
                if record is None:
                    yield row_of_failure(run, batch.failures[run])
                    continue
                records.append(record)
                coverage = record.run["association"]["groundtruth_coverage"]
                yield from rows_of_run(run, record, batch.own_coverage.get(run, coverage))
            pooled.extend(pooled_rows(algorithm, sequence, len(runs), records))

    # Failed runs are tried again the next time, so such a table is never taken for the last one.
    state = "" if batch.progress.failed else state
    write_table(folder / RUNS, rows(), batch.plan, state)
    if state and batch.progress.failed:  # by a record that could be read no more, just now
        pooled.clear()
        state = ""
        write_table(folder / RUNS, rows(), batch.plan, state)
    write_pooled(folder / POOLED, pooled, batch.plan, state)
