"""What many runs cost beside their evaluation: memory, time, files and pages, by their number.

Tiny runs are compared in several sizes, each step in a process of its own: on processes of this
machine, going on where nothing is left to do, and on a Dask cluster.
From the sizes follow exponents, and from these what a million runs would take.

Usage: python -m benchmarks.scale [--runs 1000,5000,20000] [--workers 2] [--dask-workers 4]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.generated_runs import ALGORITHMS, write_runs
from benchmarks.many_runs import ONE_THREAD

HERE = Path(__file__).parent
SEQUENCES = 20
POSES = 60
LOOP, POOL, AGAIN, DASK = "a bare loop", "evaluated", "nothing to do", "on Dask"
MILLION = 1_000_000
GOALS = {"memory": 1.3, "overhead_ms": 6.0, "resume_s": 5.0}


def measure_loop(config: Path) -> dict[str, float]:
    """Evaluate all runs in this process and keep nothing: what can't be saved."""
    from trajeval_ros.batch.config import plan_of
    from trajeval_ros.batch.worker import Task, work

    plan = plan_of(config, {})
    begun = time.process_time()
    for run in sorted(plan.runs, key=lambda run: run.sequence):
        assert work(Task(run, plan.request, (run.groundtruth, ""))).entry
    return {"runs": len(plan.runs), "cpu_s": time.process_time() - begun}


def measure_command(arguments: list[str]) -> dict[str, float]:
    """Run a command of trajeval in this process; return what it and its workers cost."""
    from trajeval_ros.cli.app import main

    begun = time.perf_counter()
    status = main(arguments)
    assert status == 0, status
    own, children = (
        resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return {
        "wall_s": time.perf_counter() - begun,
        "cpu_s": own.ru_utime + own.ru_stime,
        "workers_cpu_s": children.ru_utime + children.ru_stime,
        "peak_mib": own.ru_maxrss / 1024.0,
    }


def in_a_process(*arguments: str) -> dict[str, float]:
    """Measure in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.scale", "--measure", *arguments],
        env={**os.environ, **ONE_THREAD},
        check=True,
        capture_output=True,
        text=True,
    )
    costs: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return costs


def steps_of(
    config: Path, out: Path, workers: int, address: str | None
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield each step with what it cost."""
    compare = ("compare", str(config), "--quiet")
    pool = ("--workers", str(workers))
    yield LOOP, in_a_process(LOOP, str(config))
    whole = out / "whole"
    yield POOL, {**in_a_process(*compare, *pool, "--output", str(whole)), **left_by(whole)}
    yield AGAIN, in_a_process(*compare, "--output", str(whole))
    if address is not None:
        far = out / "far"
        yield DASK, in_a_process(*compare, "--cluster", address, "--output", str(far))
        assert (whole / "runs.parquet").read_bytes() == (far / "runs.parquet").read_bytes()


def left_by(folder: Path) -> dict[str, float]:
    """Return what a comparison left on disk."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    pages = [file.stat().st_size for file in files if file.suffix == ".html"]
    return {
        "files": len(files),
        "record_files": len(list((folder / "runs").iterdir())),
        "records_mb": sum(path.stat().st_size for path in (folder / "runs").iterdir()) / 1e6,
        "largest_page_mb": max(pages, default=0) / 1e6,
        "tables_mb": sum(file.stat().st_size for file in files if file.suffix == ".parquet") / 1e6,
    }


@contextmanager
def cluster(workers: int) -> Iterator[str | None]:
    """Yield the address of a Dask cluster of processes; None without workers."""
    if not workers:
        yield None
        return
    import distributed

    os.environ.update(ONE_THREAD)
    start: Any = distributed.LocalCluster
    with start(
        n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as local:
        yield local.scheduler_address


def exponent(sizes: list[int], values: list[float]) -> float:
    """Return the slope of values over sizes, both as logarithms, by the least and the largest."""
    return math.log(values[-1] / values[0]) / math.log(sizes[-1] / sizes[0])


def report_on(outcome: dict[int, dict[str, dict[str, float]]]) -> None:
    """Print exponents, what a million runs would take, and goals beside figures."""
    sizes = sorted(outcome)
    least, most = outcome[sizes[0]], outcome[sizes[-1]]
    ratio = most[POOL]["peak_mib"] / least[POOL]["peak_mib"]
    overhead = 1e3 * (
        most[POOL]["cpu_s"] + most[POOL]["workers_cpu_s"] - most[LOOP]["cpu_s"]
    ) / sizes[-1]  # fmt: skip
    print(f"\nparent's memory, {sizes[-1]} runs against {sizes[0]}: {ratio:.2f}x "
          f"(goal {GOALS['memory']}x at 20000 against 1000)")  # fmt: skip
    print(f"overhead: {overhead:.1f} ms CPU a run (goal {GOALS['overhead_ms']:.0f})")
    print(f"going on with {sizes[-1]} runs that are finished: {most[AGAIN]['wall_s']:.1f} s "
          f"(goal {GOALS['resume_s']:.0f} s at 20000)")  # fmt: skip
    print(f"files of records: {most[POOL]['record_files']:.0f}; largest page "
          f"{most[POOL]['largest_page_mb']:.1f} MB")  # fmt: skip
    if len(sizes) < 2:
        return
    print(f"\n{'step':<18}{'figure':<18}{'exponent':>9}{'a million runs':>18}")
    for step in (name for name in most if name != LOOP):
        for name, value in most[step].items():
            first = least[step][name]
            if name in ("files", "record_files") or first <= 0.0 or value <= 0.0:
                continue
            grows = exponent(sizes, [outcome[size][step][name] for size in sizes])
            then = value * (MILLION / sizes[-1]) ** max(grows, 0.0)
            print(f"{step:<18}{name:<18}{grows:>9.2f}{then:>18.4g}")


def main() -> None:
    """Measure all sizes and print what follows from them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", default="1000,5000,20000")
    parser.add_argument("--workers", default=2, type=int)
    parser.add_argument("--dask-workers", default=4, type=int)
    parser.add_argument("--data", default=HERE / "data" / "scale", type=Path)
    parser.add_argument("--measure", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        loop = options.measure[0] == LOOP
        costs = (
            measure_loop(Path(options.measure[1])) if loop else measure_command(options.measure)
        )
        print(json.dumps(costs))
        return
    result: dict[int, dict[str, dict[str, Any]]] = {}
    print(f"load before {os.getloadavg()}", flush=True)
    with cluster(options.dask_workers) as address:
        for count in map(int, options.runs.split(",")):
            trials = -(-count // (ALGORITHMS * SEQUENCES))
            file, settings = options.data / f"runs_{count}.yaml", ["gauge: yaw", "lengths: [0.1]"]
            config = write_runs(file, SEQUENCES, trials, POSES, settings)
            out = options.data / "out"
            shutil.rmtree(out, ignore_errors=True)
            result[count] = {}
            for name, costs in steps_of(config, out, options.workers, address):
                result[count][name] = costs
                shown = {key: round(value, 2) for key, value in costs.items()}
                print(count, name, shown, flush=True)
            shutil.rmtree(out)
    report_on(result)
    print(f"load after {os.getloadavg()}")


if __name__ == "__main__":
    main()
