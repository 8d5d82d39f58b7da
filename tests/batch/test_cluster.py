"""A Dask cluster of real processes on this machine, of which one is killed half way."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import here, write_runs
from waiting import PATIENCE_S, until

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")
pytest.importorskip("distributed", reason="dask.distributed is missing, the extra `cluster`")

from paths import ROOT

from trajeval_ros.batch import executors
from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.executors import dask_pool
from trajeval_ros.batch.records import RecordStore, entry_head
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError

pytestmark = pytest.mark.slow


class Cluster:
    """A scheduler and workers, each a process that is reached on loopback alone."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "tests"))),
        }
        self.processes: list[subprocess.Popen[bytes]] = []
        file = folder / "scheduler.json"
        self._start(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
            "--no-dashboard", "--scheduler-file", str(file),
        )  # fmt: skip
        self._wait_for(file.is_file)
        from distributed import Client

        self.client = Client(scheduler_file=str(file), set_as_default=False)
        self.address: str = self.client.scheduler.address

    def add_worker(self) -> None:
        """Start one more process, which no nanny starts anew when it is killed."""
        name = str(len(self.processes))
        self._start(
            "distributed.cli.dask_worker", self.address, "--host", "127.0.0.1", "--no-nanny",
            "--no-dashboard", "--nthreads", "1", "--name", name,
            "--local-directory", str(self._folder),
        )  # fmt: skip
        self._wait_for(
            lambda: name in {str(worker["name"]) for worker in self._workers().values()}
        )

    def end(self) -> None:
        self.client.close()
        for process in reversed(self.processes):
            process.kill()
            process.wait()

    def _workers(self) -> dict[str, Any]:
        workers: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
        return workers

    def _start(self, module: str, *arguments: str) -> None:
        with (self._folder / f"{len(self.processes)}.log").open("wb") as log:
            self.processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", module, *arguments],
                    env=self._environment, stdout=log, stderr=log,
                )
            )  # fmt: skip

    def _wait_for(self, what: Callable[[], bool]) -> None:
        def has_ended() -> bool:
            return any(process.poll() is not None for process in self.processes)

        until(lambda: what() or has_ended(), "the cluster starts")
        assert not has_ended(), [log.read_text()[-800:] for log in self._folder.glob("*.log")]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    folder = tmp_path / "cluster"
    folder.mkdir()
    cluster = Cluster(folder)
    try:
        yield cluster
    finally:
        cluster.end()


def test_a_worker_is_killed_and_nothing_is_lost_or_twice(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.add_worker()
    cluster.add_worker()
    config = write_runs(tmp_path, trials=10)
    plan = plan_of(config, {})
    kept: list[str] = []
    add = RecordStore.add

    def add_and_kill(store: RecordStore, entry: bytes) -> None:
        add(store, entry)
        head = entry_head(entry)
        assert head is not None
        kept.append(head.key)
        if len(kept) == 12:
            cluster.processes[-1].kill()

    monkeypatch.setattr(RecordStore, "add", add_and_kill)
    progress = run_plan(plan, tmp_path / "far", lambda: dask_pool(cluster.address))
    assert cluster.processes[-1].wait(PATIENCE_S) != 0
    assert (progress.done, progress.failed) == (40, 0)
    assert Counter(kept) == dict.fromkeys(kept, 1)
    rows = ResultsTable(tmp_path / "far" / "runs.parquet").select(
        ["algorithm", "sequence", "trial", "key"], kind="ate", metric="position_m"
    )
    assert len(rows) == 40
    assert {row["key"] for row in rows} == set(kept)
    # And the numbers are those of this machine.
    run_plan(plan, tmp_path / "near", here)
    assert summary_of(tmp_path / "far").trials == summary_of(tmp_path / "near").trials


def test_workers_of_other_sources_are_refused(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.add_worker()
    assert dask_pool(cluster.address).workers == 1
    monkeypatch.setattr(executors, "hash_of_numbers", os.getpid)  # another one over there
    with pytest.raises(
        InputError,
        match=r"^tcp://127.* has a different version of trajeval-ros "
        r"than",
    ):
        dask_pool(cluster.address)


def test_a_worker_that_dies_when_its_result_was_fetched_takes_nothing_with_it(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The order that a busy machine produces now and then: the loss is heard of too late."""
    from distributed import Client, Future

    cluster.add_worker()
    fetch = Client._gather_remote

    async def fetch_and_kill(client: Client, *args: Any) -> Any:
        response = await fetch(client, *args)
        [key] = response["data"]
        if len(cluster.processes) == 2:
            cluster.processes[-1].kill()
            until = time.monotonic() + PATIENCE_S
            while Future(key, client).status == "finished":
                assert time.monotonic() < until
                await asyncio.sleep(0.01)
        return response

    monkeypatch.setattr(Client, "_gather_remote", fetch_and_kill)
    progress = run_plan(
        plan_of(write_runs(tmp_path, ["hall"], ["good"], 1), {}),
        tmp_path / "out",
        lambda: dask_pool(cluster.address),
    )
    assert cluster.processes[-1].wait(PATIENCE_S) != 0
    assert (progress.done, progress.failed) == (1, 0)


def test_the_command_line_reads_urls_on_the_workers(cluster: Cluster, tmp_path: Path) -> None:
    cluster.add_worker()
    config = write_runs(tmp_path, trials=1)
    text = config.read_text()
    config.write_text(text.replace("good: good", f"good: file://{tmp_path}/good"))
    out = tmp_path / "out"
    arguments = ["--cluster", cluster.address, "--output", str(out), "--quiet"]
    assert main(["compare", str(config), *arguments]) == 0
    assert all(trial.status == "ok" for trial in summary_of(out).trials)


def test_a_scheduler_without_workers_or_none_at_all_is_told(cluster: Cluster) -> None:
    with pytest.raises(InputError, match="has no workers"):
        dask_pool(cluster.address)
    with pytest.raises(
        InputError,
        match=r"no response from a Dask scheduler at "
        r"tcp://127\.0\.0\.1:9",
    ):
        dask_pool("tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="no response from a Dask scheduler"):
        dask_pool("nowhere at all")


def test_a_lost_scheduler_keeps_what_is_finished(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.add_worker()
    plan = plan_of(write_runs(tmp_path, trials=10), {})
    add = RecordStore.add
    kept: list[bytes] = []

    def add_and_kill(store: RecordStore, entry: bytes) -> None:
        add(store, entry)
        kept.append(entry)
        if len(kept) == 10:
            cluster.processes[0].kill()

    monkeypatch.setattr(RecordStore, "add", add_and_kill)
    with pytest.raises(InputError, match="the connection to the cluster is lost"):
        run_plan(plan, tmp_path / "out", lambda: dask_pool(cluster.address))
    progress = run_plan(plan, tmp_path / "out", here)
    assert progress.kept >= 10
    assert progress.kept + progress.done == 40
