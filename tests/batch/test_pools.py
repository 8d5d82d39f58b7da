"""Processes that evaluate, die, are killed, and what is left then."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import DeadlyRun, write_run, write_runs
from waiting import PATIENCE_S, until

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")


from paths import ROOT

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.executors import Pool, evaluate_all, local_pool, results_in_order
from trajeval_ros.batch.finished_comparison import RUNS
from trajeval_ros.batch.plan import Plan, PlannedRun
from trajeval_ros.batch.records import OWN, RECORDS, RecordStore
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.batch.worker import Task, WorkerResult
from trajeval_ros.exceptions import InputError
from trajeval_ros.metrics.protocol import Protocol, metres
from trajeval_ros.pipeline.request import Request

pytestmark = pytest.mark.slow


def tasks_of(folder: Path, count: int, deadly: tuple[int, ...] = ()) -> list[Task]:
    truth = str(write_run(folder / "truth.txt", count=500))
    protocol = Protocol(lengths=metres(8))
    tasks = []
    for number in range(count):
        estimate = str(write_run(folder / f"{number}.txt", 1.0 + 0.01 * number))
        kind: type[PlannedRun] = DeadlyRun if number in deadly else PlannedRun
        run = kind("vio", "hall", str(number), truth, estimate)
        tasks.append(Task(run, Request(protocol), ("truth", str(number))))
    return tasks


def test_a_run_that_kills_its_process_fails_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TRAJEVAL_TEST_PARENT", str(os.getpid()))
    tasks = tasks_of(tmp_path, 12, deadly=(1, 7))
    finished: dict[str, list[WorkerResult]] = {}

    def finish(task: Task, outcome: WorkerResult) -> None:
        finished.setdefault(task.run.trial, []).append(outcome)

    evaluate_all(local_pool(2), tasks, finish)
    assert sorted(finished, key=int) == [str(number) for number in range(12)]
    assert all(len(outcomes) == 1 for outcomes in finished.values())
    died = [trial for trial, (outcome,) in finished.items() if outcome.entry is None]
    assert sorted(died) == ["1", "7"]
    assert "worker process was killed" in finished["7"][0].reason


def test_workers_use_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
    for name in names:
        monkeypatch.delenv(name, raising=False)
    # What the user says stays.
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    with local_pool(1).start(1) as executor:
        result = [executor.submit(os.getenv, name).result() for name in names]
    assert result == ["7", "1", "1"]
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"
    assert "OMP_NUM_THREADS" not in os.environ


def test_a_deadly_run_stays_in_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRAJEVAL_TEST_PARENT", str(os.getpid()))
    plan = plan_of(write_runs(tmp_path), {})
    first = plan.runs[0]
    deadly = DeadlyRun(**{name: getattr(first, name) for name in first.__dataclass_fields__})
    plan = Plan(plan.title, (deadly, *plan.runs[1:]), plan.request)
    progress = run_plan(plan, tmp_path / "out", lambda: local_pool(2))
    assert (progress.done, progress.failed) == (7, 1)
    (lost,) = ResultsTable(tmp_path / "out" / RUNS).select(["trial", "reason"], status="failed")
    assert "was killed" in lost["reason"]


class Failing(ThreadPoolExecutor):
    """A cluster whose calls end with an exception."""

    def __init__(self, error: Exception) -> None:
        super().__init__(1)
        self._error = error

    def submit(self, *_: Any, **__: Any) -> Future[Any]:  # type: ignore[override]
        future: Future[Any] = Future()
        future.set_exception(self._error)
        return future


def test_a_killed_worker_of_a_cluster_leaves_the_tables() -> None:
    scheduler = pytest.importorskip("distributed.scheduler", reason="Dask is missing")
    state = scheduler.WorkerState(
        address="tcp://127.0.0.1:1", status="closed", pid=1, name="w", nthreads=1,
        memory_limit=1, local_directory="", nanny="", server_id="w", services={}, extra={},
    )  # fmt: skip
    killed = scheduler.KilledWorker("figure", state, 3)

    def drawn(error: Exception) -> list[Any]:
        return list(results_in_order(Pool(lambda _: Failing(error), 1), str, ["figure"]))

    for error in (killed, BrokenExecutor()):
        with pytest.raises(InputError, match="; the tables are complete; draw again"):
            drawn(error)
    with pytest.raises(InputError, match="connection to the cluster is lost"):
        drawn(CancelledError())  # type: ignore[arg-type]
    with pytest.raises(ZeroDivisionError):  # of a figure
        drawn(ZeroDivisionError())


def children_of(process: int) -> list[int]:
    listed = Path(f"/proc/{process}/task/{process}/children")
    return [int(child) for child in listed.read_text().split()]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc to look into")
def test_ctrl_c_while_workers_start_is_one_line(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "trajeval_ros", "compare", str(write_runs(tmp_path, trials=20)),
        "--workers", "2", "--output", str(tmp_path / "out"),
    ]  # fmt: skip
    process = subprocess.Popen(
        command,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    until(lambda: process.poll() is not None or len(children_of(process.pid)) > 1, "workers start")
    os.killpg(process.pid, signal.SIGINT)
    _, text = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, text) == (130, "trajeval: interrupted\n")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc to look into")
def test_after_a_kill_the_finished_runs_are_there_and_it_goes_on(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=30)
    out = tmp_path / "out"
    command = [
        sys.executable, "-m", "trajeval_ros", "compare", str(config), "--workers", "2",
        "--figures", "0", "--output", str(out), "--quiet",
    ]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, env=environment, text=True)
    try:
        until(
            lambda: process.poll() is not None or len(RecordStore(out / RECORDS)) > 10,
            "ten runs are finished",
        )
        workers = children_of(process.pid)
        process.send_signal(signal.SIGKILL)
        process.wait()
        # No worker is left behind.
        until(
            lambda: not any(Path(f"/proc/{worker}/cwd").exists() for worker in workers),
            "the workers end",
        )
    finally:
        process.kill()
        process.wait()
    kept = (out / RECORDS / OWN).read_bytes()
    assert 10 < len(RecordStore(out / RECORDS)) < 120
    subprocess.run(command, env=environment, check=True)
    assert len(RecordStore(out / RECORDS)) == 120
    # What was whole stays; what was being written is cut off.
    again = (out / RECORDS / OWN).read_bytes()
    assert again.startswith(kept[: len(kept) * 9 // 10])
    rows = ResultsTable(out / RUNS).select(["key"], kind="ate", metric="position_m", status="ok")
    assert len(rows) == len({row["key"] for row in rows}) == 120


def test_records_are_made_by_the_workers_as_here(tmp_path: Path) -> None:
    from trajeval_ros.batch.worker import work

    (task,) = tasks_of(tmp_path, 1)
    finished: list[WorkerResult] = []
    evaluate_all(local_pool(1), [task], lambda _, outcome: finished.append(outcome))
    here, (there,) = work(task), finished
    assert here.entry
    assert there == here
