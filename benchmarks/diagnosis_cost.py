"""What a diagnosis costs: next to the evaluation, and how much a mistake adds to it."""

from __future__ import annotations

import contextlib
import dataclasses
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.diagnosis_mistakes import Mistake
from benchmarks.diagnosis_runs import Pair, simulated
from trajeval_ros.diagnosis.diagnose import diagnose
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.request import Request

_TIMES, _PAIRED = 7, 3
_GOAL = 1.5  # largest ratio that users do not notice


def cost() -> None:
    """Print the CPU time of evaluations, of their diagnoses, and of the command."""
    print("\n| poses | ATE | with relative errors | diagnosis | command |\n|---|---|---|---|---|")
    for count, duration_s in ((10_000, 600.0), (100_000, 600.0), (1_000_000, 6000.0)):
        pair = _dense(simulated(1, "drone", "walk", duration_s), count)
        whole = dataclasses.replace(pair.protocol, lengths=Protocol().lengths)
        evaluation = evaluate(pair.truth, pair.estimate, pair.protocol)
        steps = (
            lambda: evaluate(pair.truth, pair.estimate, pair.protocol),  # noqa: B023
            lambda: evaluate(pair.truth, pair.estimate, whole),  # noqa: B023
            lambda: diagnose(evaluation, pair.truth, pair.estimate),  # noqa: B023
        )
        taken = [_least_ms(step) for step in steps]
        cells = [f"{item:.1f} ms" for item in (*taken, _command_ms(pair))]
        print(f"| {count} | {' | '.join(cells)} |", flush=True)


def cost_of_mistakes(mistakes: Mapping[str, Mistake], counts: Sequence[int]) -> None:
    """Print the CPU time of an evaluation with a mistake, relative to the right recording.

    Both are run alternately, so that other processes slow down both.
    """
    columns = " | ".join(f"{count} poses" for count in counts)
    print(f"\n| evaluation with a mistake over that without | {columns} |")
    print("|---|" + "---|" * len(counts))
    # Its motions are usual, so that no search for discontinuities hides the cost of a diagnosis.
    right = simulated(3, "drone", "walk", 600.0)
    ratios: list[list[float]] = []
    for name, mistake in mistakes.items():
        row = []
        for count in counts:
            pair = _dense(right, count)
            if mistake.applies(pair):
                row.append(_ratio(pair, mistake.make(pair)))
        if row:
            ratios.append(row)
            print(f"| {name} | {' | '.join(f'{ratio:.2f}' for ratio in row)} |", flush=True)
    for column, count in zip(zip(*ratios, strict=True), counts, strict=True):
        slow = sum(ratio > _GOAL for ratio in column)
        print(
            f"{count} poses: median {np.median(column):.2f}, largest {max(column):.2f}, "
            f"{slow} of {len(column)} above {_GOAL:g}"
        )


def _ratio(right: Pair, wrong: Pair) -> float:
    """Return the CPU time of `run` on a wrong pair over that on the right one."""
    taken: tuple[list[float], list[float]] = [], []
    for _ in range(_PAIRED):
        for pair, times in zip((right, wrong), taken, strict=True):
            begin = time.process_time()
            with contextlib.suppress(TrajevalError):  # some inputs can't be evaluated
                run(pair.truth, [pair.estimate], Request(pair.protocol))
            times.append(time.process_time() - begin)
    return min(taken[1]) / min(taken[0])


def _least_ms(step: Callable[[], object]) -> float:
    taken = []
    for _ in range(_TIMES):
        begin = time.process_time()
        step()
        taken.append(time.process_time() - begin)
    return 1e3 * min(taken)


def _command_ms(pair: Pair) -> float:
    """Return the CPU time of `trajeval evaluate` from its start to its end."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder) / name) for name in ("groundtruth.txt", "estimate.txt")]
        for path, side in zip(paths, (pair.truth, pair.estimate), strict=True):
            _write(side, path)
        words = ["evaluate", "-g", paths[0], "-e", paths[1], "--gauge", "yaw", "--quiet"]
        before = _children_ms()
        command = [sys.executable, "-m", "trajeval_ros", *words]
        subprocess.run(command, check=True, capture_output=True)
        return _children_ms() - before


def _children_ms() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (used.ru_utime + used.ru_stime)


def _write(side: Trajectory, path: str) -> None:
    assert side.quaternions is not None
    columns = [side.stamps / 1e9, side.positions, side.quaternions]
    np.savetxt(path, np.column_stack(columns), fmt="%.9f")


def _dense(pair: Pair, count: int) -> Pair:
    """Return a pair with more poses: `count` of the estimate, twice as many of the groundtruth."""
    sides = {}
    for side, number in (("estimate", count), ("truth", 2 * count)):
        one = getattr(pair, side)
        track = TimedPoses.of(one, int(one.stamps[0]))
        seconds = np.linspace(0.0, track.span_s, number)
        between = track.at(seconds)
        stamps = int(one.stamps[0]) + np.rint(1e9 * seconds).astype(np.int64)
        sides[side] = type(one).from_columns(stamps, between.positions, between.quaternions)
    return dataclasses.replace(pair, **sides)
