"""Times `trajeval compare` on a thousand generated runs: speed-up, overhead, memory, going on.

Each measurement is a process of its own. `a bare loop` evaluates the runs one after the other and
keeps nothing; `one process` does all that a comparison does, without a pool; the CPU time of the
parent of a pool is the overhead.

Usage: python -m benchmarks.many_runs [--runs 1000] [--poses 5000] [--data FOLDER]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.generated_runs import ALGORITHMS, write_runs

HERE = Path(__file__).parent
SEQUENCES = 10
LOOP, ALONE, ONE, TWO = "a bare loop", "one process", "1 worker", "2 workers"
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def measure(config: Path, out: Path, how: str) -> dict[str, float]:
    """Evaluate all runs in a bare loop, in this process, or on a pool; return what it cost."""
    from trajeval_ros.batch.comparison import run_plan
    from trajeval_ros.batch.config import plan_of
    from trajeval_ros.batch.executors import Pool, local_pool
    from trajeval_ros.batch.worker import Task, work

    plan = plan_of(config, {})
    start, cpu = time.perf_counter(), time.process_time()
    if how == LOOP:
        for run in sorted(plan.runs, key=lambda run: run.sequence):
            assert work(Task(run, plan.request, (run.groundtruth, ""))).entry
    else:
        here = Pool(ThreadPoolExecutor, 1)
        progress = run_plan(plan, out, lambda: here if how == ALONE else local_pool(int(how[0])))
        assert (progress.done, progress.failed) == (len(plan.runs), 0)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "runs": len(plan.runs),
        "wall_s": time.perf_counter() - start,
        "cpu_s": time.process_time() - cpu,
        "workers_cpu_s": children.ru_utime + children.ru_stime,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def in_a_process(config: Path, out: Path, how: str) -> dict[str, float]:
    """Measure in a process of its own."""
    command = [
        sys.executable, "-m", "benchmarks.many_runs", "--measure",
        str(config), str(out), how,
    ]  # fmt: skip
    environment = {**os.environ, **ONE_THREAD}
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    costs: dict[str, float] = json.loads(done.stdout)
    return costs


def resumed(config: Path, out: Path) -> dict[str, float]:
    """Time the command line where there is nothing to do: the second time it draws no report."""
    command = [
        sys.executable, "-m", "trajeval_ros", "compare", str(config), "--output", str(out), "-q",
    ]  # fmt: skip
    walls = []
    for _ in range(2):
        start = time.perf_counter()
        subprocess.run(command, env={**os.environ, **ONE_THREAD}, check=True)
        walls.append(time.perf_counter() - start)
    return {"report_wall_s": walls[0], "nothing_to_do_wall_s": walls[1]}


def results(config: Path, few: Path, out: Path) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield each measurement with its name."""
    for how in (LOOP, ALONE, ONE, TWO):
        shutil.rmtree(out, ignore_errors=True)
        yield how, in_a_process(config, out, how)
    yield "going on", resumed(config, out)
    shutil.rmtree(out, ignore_errors=True)
    yield "2 workers, a tenth of the runs", in_a_process(few, out, TWO)
    shutil.rmtree(out, ignore_errors=True)


def main() -> None:
    """Measure everything and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", default=1000, type=int)
    parser.add_argument("--poses", default=5000, type=int)
    parser.add_argument("--data", default=HERE / "data" / "runs", type=Path)
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        config, out, how = options.measure
        print(json.dumps(measure(Path(config), Path(out), how)))
        return
    trials = max(1, options.runs // (ALGORITHMS * SEQUENCES))
    file = options.data / "runs.yaml"
    config = write_runs(file, SEQUENCES, trials, options.poses, ["gauge: yaw"])
    few = config.with_name("few.yaml")
    text = config.read_text()
    few.write_text(f"{text[: text.index('trials:')]}trials: [0]\n")
    result: dict[str, Any] = {"load_before": os.getloadavg()}
    for name, costs in results(config, few, options.data / "out"):
        print(name, {key: round(value, 2) for key, value in costs.items()}, flush=True)
        result[name] = costs
    loop, alone, two = (result[how] for how in (LOOP, ALONE, TWO))
    count = two["runs"]
    busy = (two["cpu_s"] + two["workers_cpu_s"]) / 2.0
    print(f"load before {result['load_before']}")
    print(f"2 workers are {alone['wall_s'] / two['wall_s']:.2f}x one process")
    print(f"by CPU time alone, two idle cores would be {alone['cpu_s'] / busy:.2f}x one process, "
          f"{loop['cpu_s'] / busy:.2f}x a bare loop")  # fmt: skip
    print(f"overhead: {1e3 * two['cpu_s'] / count:.1f} ms CPU of the parent per run, "
          f"{1e3 * (alone['cpu_s'] - loop['cpu_s']) / count:.1f} ms without a pool")  # fmt: skip


if __name__ == "__main__":
    main()
