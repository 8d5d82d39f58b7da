"""A comparison from its plan to its tables; an interrupted one continues."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from trajeval_ros.batch.executors import Pool, evaluate_all
from trajeval_ros.batch.fingerprints import Fingerprints
from trajeval_ros.batch.finished_comparison import FinishedComparison, FinishedRun, has_tables
from trajeval_ros.batch.plan import Plan, PlannedRun
from trajeval_ros.batch.records import RECORDS, Record, RecordStore
from trajeval_ros.batch.results_table import load_pyarrow
from trajeval_ros.batch.worker import Task, WorkerResult, work
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.io.writing import refused_by_disk

_INPUTS = "inputs.json"


@dataclass
class Progress:
    """The progress of a comparison."""

    total: int = 0  # number of evaluations: of runs with files, twice with a common time span
    kept: int = 0  # number of evaluations that were finished before
    done: int = 0  # number of finished evaluations
    new: int = 0  # number of runs that were evaluated
    failed: int = 0  # number of failed runs
    fetched_bytes: int = 0  # bytes that the runs read from remote stores
    running: list[str] = field(default_factory=list)  # names of the runs in progress


def run_plan(
    plan: Plan,
    folder: Path,
    start_pool: Callable[[], Pool],
    report: Callable[[Progress], None] = lambda progress: None,
) -> Progress:
    """Evaluate the runs without a record, and write the tables.

    `start_pool`: returns the workers; called only if a run must be evaluated. `report`: called at
    the start and end of every run.
    """
    load_pyarrow()
    with refused_by_disk(f"the folder {folder / RECORDS}"):
        (folder / RECORDS).mkdir(parents=True, exist_ok=True)
    records, fingerprints = RecordStore(folder / RECORDS), Fingerprints(folder / _INPUTS)
    batch = _RunningComparison(plan, records, fingerprints, start_pool, report)
    if has_tables(folder):
        tasks = list(batch.planned())
        if batch.finished().is_in(folder):
            batch.progress.kept = len(tasks)
            report(batch.progress)
            return batch.progress
    batch.evaluate(batch.planned())
    if plan.common_time_span:
        batch.cut_to_common_spans()
    batch.finished().write_tables(folder, batch.record_of)
    return batch.progress


class _RunningComparison:
    """The runs of one comparison: their tasks, and the reasons of failed ones."""

    def __init__(
        self,
        plan: Plan,
        records: RecordStore,
        fingerprints: Fingerprints,
        start_pool: Callable[[], Pool],
        report: Callable[[Progress], None],
    ) -> None:
        self.plan = plan
        self.records = records
        self.progress = Progress(total=sum(not run.missing for run in plan.runs))
        self.failures: dict[PlannedRun, str] = {}
        self.tasks: dict[PlannedRun, Task] = {}
        self.planned_keys: dict[PlannedRun, str] = {}
        self.own_coverage: dict[PlannedRun, float] = {}
        self.common_share: dict[PlannedRun, float] = {}
        self._evaluated: set[PlannedRun] = set()
        self._fingerprints = fingerprints
        self._start_pool = start_pool
        self._report = report

    def planned(self) -> Iterator[Task]:
        """Yield the tasks, while their inputs are hashed.

        Trials of a sequence are consecutive, because workers keep its groundtruth.
        """
        for run in sorted(self.plan.runs, key=lambda run: (run.sequence, run.groundtruth)):
            if run.missing:
                self.failures[run] = run.missing
            elif run not in self.tasks and run not in self.failures:
                try:
                    of = self._fingerprints.of
                    inputs = (of(run.groundtruth), of(run.estimate))
                    task = Task(run, self.plan.request_of(run), inputs)
                    self.tasks[run], self.planned_keys[run] = task, task.key
                except TrajevalError as error:
                    self._fail(run, str(error))
            if run in self.tasks:
                yield self.tasks[run]
        self._fingerprints.save()

    def finished(self) -> FinishedComparison:
        """Return the current status of all runs."""
        runs = []
        for run in self.plan.runs:
            task = self.tasks.get(run)
            key = "" if task is None or run in self.failures else task.key
            reason = self.failures.get(run, "")
            planned = self.planned_keys.get(run, "")
            coverage, common = self.own_coverage.get(run), self.common_share.get(run, 1.0)
            runs.append(FinishedRun(run, planned, key, reason, coverage, common))
        return FinishedComparison(self.plan.title, self.plan.settings, runs)

    def evaluate(self, tasks: Iterable[Task]) -> None:
        """Evaluate the runs without a record."""

        def without_record() -> Iterator[Task]:
            for task in tasks:
                if task.key in self.records:
                    self.progress.kept += 1
                    self._report(self.progress)
                else:
                    yield task

        todo = without_record()
        if (first := next(todo, None)) is not None:
            evaluate_all(self._start_pool(), chain([first], todo), self._finish, self._show)
        self._show([])

    def cut_to_common_spans(self) -> None:
        """Evaluate the runs of every sequence again, over the time that all of them cover."""
        spans: dict[str, list[tuple[int, int]]] = defaultdict(list)
        for run, task in self.tasks.items():
            if run not in self.failures:
                record = self._record(task, with_pooled=False)
                spans[run.sequence].append(record.span_ns)
                self.own_coverage[run] = record.run["association"]["groundtruth_coverage"]
        cut = {}
        for run, task in self.tasks.items():
            if run in self.failures:
                continue
            starts, ends = zip(*spans[run.sequence], strict=True)
            span = (max(starts), min(ends))
            if span[0] >= span[1]:
                self._fail(run, f"the runs of {run.sequence} have no common time span")
            else:
                request = dataclasses.replace(task.request, span_ns=span)
                cut[run] = Task(run, request, task.inputs)
        self.tasks = cut
        self.progress.total += len(cut)
        self.evaluate(cut.values())
        shares: dict[tuple[str, str], float] = defaultdict(float)
        of = {run: (run.sequence, run.groundtruth) for run in cut if run not in self.failures}
        for run, key in of.items():
            association = self._record(cut[run], with_pooled=False).run["association"]
            shares[key] = max(shares[key], association["groundtruth_span"])
        self.common_share = {run: shares[key] for run, key in of.items()}

    def record_of(self, finished: FinishedRun) -> Record:
        """Return the record of a run."""
        return self._record(self.tasks[finished.run])

    def _record(self, task: Task, *, with_pooled: bool = True) -> Record:
        """Return a record; a run whose record can't be read is evaluated again."""
        record = self.records.read(task.key, with_pooled=with_pooled)
        if record is None:
            self.records.forget(task.key)
            self._finish(task, work(task))
            record = self.records.read(task.key)
        if record is None:
            raise InputError(
                f"{task.run.name} was evaluated, and its record can't be read: "
                f"{self.failures.get(task.run, 'its record is damaged')}; start again"
            )
        return record

    def _finish(self, task: Task, outcome: WorkerResult) -> None:
        self.progress.fetched_bytes += outcome.fetched_bytes
        if outcome.entry is None:
            self._fail(task.run, outcome.reason)
        else:
            self.records.add(outcome.entry)
            self.progress.done += 1
            self._evaluated.add(task.run)
            self.progress.new = len(self._evaluated)
        self._report(self.progress)

    def _fail(self, run: PlannedRun, reason: str) -> None:
        self.failures[run] = reason
        self.progress.failed += 1

    def _show(self, running: list[Task]) -> None:
        self.progress.running = [task.run.name for task in running]
        self._report(self.progress)
