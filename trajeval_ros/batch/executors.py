"""Evaluates runs on processes of this machine or on the workers of a Dask cluster.

Both are a `concurrent.futures.Executor`. If a worker dies, only its run fails.
"""

from __future__ import annotations

import functools
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import chain
from multiprocessing import connection, get_context, parent_process
from typing import Any

from trajeval_ros.batch.source_hash import hash_of_numbers
from trajeval_ros.batch.worker import Task, WorkerResult, work
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.linear_algebra_threads import one_thread_for_children

Finish = Callable[[Task, WorkerResult], None]

_PATIENCE_S = 10.0
_KILLED = "KilledWorker"  # of dask.distributed
_DIED = "the worker process was killed, probably out of memory"


@dataclass(frozen=True)
class Pool:
    """Executors that can be started, and started again after a failure."""

    # Starts an executor with a number of workers.
    start: Callable[[int], AbstractContextManager[Executor]]
    workers: int
    # Number of runs that wait in the executor. Workers must not become idle, and memory must not
    # grow with the number of runs.
    ahead: int = field(default=2)


def local_pool(workers: int | None) -> Pool:
    """Return processes of this machine, by default one per available core."""
    if workers is None and hasattr(os, "sched_getaffinity"):
        workers = len(os.sched_getaffinity(0))
    return Pool(_processes, workers or os.cpu_count() or 1)


def dask_pool(address: str) -> Pool:
    """Return the workers of a Dask cluster."""
    try:
        import distributed
    except ImportError as error:
        raise InputError(
            f"--cluster needs dask.distributed; install it: {extra_command('cluster')}"
        ) from error
    connect: Any = functools.partial(
        distributed.Client, address, timeout=_PATIENCE_S, set_as_default=False
    )
    try:
        with connect() as client:
            threads = sum(client.nthreads().values())
            sources = client.run(hash_of_numbers) if threads else {}
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no response from a Dask scheduler at {address}: {error}") from error
    except ModuleNotFoundError as error:
        raise InputError(
            f"a package is missing on the workers at {address}: {error}; install trajeval-ros "
            "there"
        ) from error
    if not threads:
        raise InputError(f"the Dask scheduler at {address} has no workers; start workers")
    other = [
        worker for worker, hash_of_worker in sources.items() if hash_of_worker != hash_of_numbers()
    ]
    if other:
        raise InputError(
            f"{other[0]} has a different version of trajeval-ros than this machine; install the "
            "same version"
        )

    @contextmanager
    def start(workers: int) -> Iterator[Executor]:  # noqa: ARG001 - the cluster sets the number
        with connect() as client:
            yield _Workers(client)

    return Pool(start, threads, ahead=max(8, threads))


def evaluate_all(
    pool: Pool,
    tasks: Iterable[Task],
    finish: Finish,
    on_running: Callable[[list[Task]], None] = lambda running: None,
) -> None:
    """Evaluate runs on a pool.

    `tasks`: the runs; taken when workers become free. `finish`: called in this thread, once per
    run, with its result, in order of completion. `on_running`: called with the runs in progress,
    at every change.
    """
    waiting = iter(tasks)
    suspects: list[Task] = []
    exhausted = False
    while not exhausted:
        with pool.start(pool.workers) as executor:
            exhausted = _drain(pool, executor, waiting, suspects, finish, on_running)
        # One of the submitted runs broke the executor: evaluate every one in a new executor.
        for task in suspects:
            on_running([task])
            with pool.start(1) as executor:
                finish(task, _outcome(executor.submit(work, task)))
        suspects.clear()


def results_in_order(
    pool: Pool, call: Callable[[Any], Any], tasks: Iterable[Any]
) -> Iterator[tuple[Any, Any]]:
    """Yield tasks with their results, in the order of the tasks; no pool starts without a task.

    Raises:
        InputError: A worker was killed, or the connection to the cluster is lost.
    """
    waiting = iter(tasks)
    if (first := next(waiting, None)) is None:
        return
    running: deque[tuple[Any, Future[Any]]] = deque()
    with pool.start(pool.workers) as executor:
        try:
            for task in chain([first], waiting):
                running.append((task, executor.submit(call, task)))
                if len(running) > pool.workers + pool.ahead:
                    task, future = running.popleft()
                    yield task, future.result()
            for task, future in running:
                yield task, future.result()
        except Exception as error:
            if not isinstance(error, BrokenExecutor) and not _is_of_cluster(error):
                raise
            raise InputError(
                f"{_failure(error)}; the tables are complete; draw again with fewer --workers, or "
                "use --figures 0"
            ) from error


def _drain(
    pool: Pool,
    executor: Executor,
    waiting: Iterator[Task],
    suspects: list[Task],
    finish: Finish,
    on_running: Callable[[list[Task]], None],
) -> bool:
    """Evaluate tasks until all are done (return True) or the executor breaks (False)."""
    running: dict[Future[WorkerResult], Task] = {}
    room = pool.workers + pool.ahead
    while True:
        while len(running) < room and (task := next(waiting, None)) is not None:
            running[_submit(executor, task)] = task
        if not running:
            return True
        on_running(list(running.values())[: pool.workers])
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            try:
                outcome = future.result()
            except BrokenExecutor:
                for item in [*running]:
                    if item.done() and not item.cancelled() and item.exception() is None:
                        finish(running.pop(item), item.result())
                suspects += running.values()
                return False
            except Exception as error:
                outcome = WorkerResult(None, _failure(error))
            finish(running.pop(future), outcome)


def _submit(executor: Executor, task: Task) -> Future[WorkerResult]:
    """Submit a run. If the executor is broken, return a future that failed with it."""
    try:
        return executor.submit(work, task)
    except BrokenExecutor as error:
        future: Future[WorkerResult] = Future()
        future.set_exception(error)
        return future


def _outcome(future: Future[WorkerResult]) -> WorkerResult:
    try:
        return future.result()
    except Exception as error:
        return WorkerResult(None, _failure(error))


def _failure(error: Exception) -> str:
    """Return the reason of a failure outside of the run's evaluation."""
    if isinstance(error, BrokenExecutor) or type(error).__name__ == _KILLED:
        return _DIED
    if _is_of_cluster(error):
        raise InputError(
            "the connection to the cluster is lost; start again to continue, finished runs are "
            "kept"
        ) from error
    return f"{type(error).__name__}: {error}"


def _is_of_cluster(error: Exception) -> bool:
    """Return whether a cluster lost a worker or its connection, by names of dask.distributed."""
    names = (_KILLED, "FutureCancelledError")
    return isinstance(error, CancelledError) or type(error).__name__ in names


class _Workers(Executor):
    """The workers of a Dask client.

    Dask's own executor reads a future's state after fetching its result. If the worker died in
    between, the state is no longer "finished", and the result is treated as an error.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call to a worker."""
        # pure=False gives every run its own key, which separates simultaneous comparisons.
        remote = self._client.submit(fn, *args, pure=False, **kwargs)
        local: Future[Any] = Future()
        self._client.loop.add_callback(_pass_on, remote, local)
        return local


async def _pass_on(remote: Any, local: Future[Any]) -> None:
    """Wait for a future of Dask and copy its result to another future."""
    try:
        result = await remote
    except Exception as error:
        local.set_exception(error)
    else:
        local.set_result(result)


@contextmanager
def _processes(workers: int) -> Iterator[Executor]:
    # One thread per process: the processes use all cores.
    with one_thread_for_children():
        # Spawned, because a fork copies the threads and locks of a notebook.
        executor = _Processes(workers, mp_context=get_context("spawn"), initializer=_begin_worker)
        try:
            yield executor
        finally:
            executor.shutdown(cancel_futures=True)


class _Processes(ProcessPoolExecutor):
    """Processes that ignore Ctrl-C from their start; their parent handles it."""

    def submit(self, *args: Any, **options: Any) -> Future[Any]:
        """Submit a call. This starts processes, which inherit the blocked signal."""
        if not hasattr(signal, "pthread_sigmask"):
            return super().submit(*args, **options)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(*args, **options)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker() -> None:
    """Ignore Ctrl-C, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None

    def end_with_parent() -> None:
        # If the parent is killed, the queue does not close: all workers hold its other end.
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
