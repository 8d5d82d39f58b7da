"""Folders of many small runs, and runs that take their process down."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.batch import executors
from trajeval_ros.batch.executors import Pool
from trajeval_ros.batch.plan import PlannedRun
from trajeval_ros.cli.app import main


def write_run(path: Path, scale: float = 1.0, *, count: int = 300, seconds: float = 20.0) -> Path:
    """Write a loop of 25 m flown in 20 s, or its beginning; `scale` makes an estimate of it."""
    time = np.linspace(0.0, seconds, count)
    rotation = 2.0 * np.pi * time / 20.0
    half = np.zeros((count, 2))
    columns = [
        1_700_000_000.0 + time,
        4.0 * scale * np.cos(rotation),
        4.0 * scale * np.sin(rotation),
        scale * np.sin(3.0 * rotation),
        *half.T,
        np.sin(rotation / 2.0),
        np.cos(rotation / 2.0),
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(columns), fmt="%.9f")
    return path


def write_runs(
    folder: Path,
    sequences: Iterable[str] = ("hall", "yard"),
    algorithms: Iterable[str] = ("good", "bad"),
    trials: int = 2,
) -> Path:
    """Write groundtruth, runs and the YAML file that compares them; return that."""
    for place, sequence in enumerate(sequences):
        write_run(folder / "groundtruth" / f"{sequence}.txt", count=500)
        for algorithm in algorithms:
            error = 0.01 if algorithm == "good" else 0.03
            for trial in range(trials):
                path = folder / algorithm / f"{sequence}_trial{trial}.txt"
                write_run(path, 1.0 + error * (1.0 + 0.1 * trial + 0.01 * place))
    runs = "".join(f"  {item}: {item}/{{sequence}}_trial{{trial}}.txt\n" for item in algorithms)
    config = folder / "runs.yaml"
    text = f"groundtruth: groundtruth/{{sequence}}.txt\nruns:\n{runs}lengths: [4, 8]\n"
    config.write_text(text)
    return config


def compare(*words: object, output: Path, figures: int = 0) -> int:
    """Run `trajeval compare` without processes, which start slowly, and with few figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executors, "local_pool", lambda _: here())
        options = ["--figures", str(figures), "--output", str(output)]
        return main(["compare", *map(str, words), *options])


def here() -> Pool:
    """Return a pool that evaluates in a thread of this process, which starts at once."""
    return Pool(ThreadPoolExecutor, 1)


@dataclass(frozen=True)
class DeadlyRun(PlannedRun):
    """A run that kills whatever other process it is sent to."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        if os.getpid() != int(os.environ["TRAJEVAL_TEST_PARENT"]):
            os.kill(os.getpid(), signal.SIGKILL)
        self.__dict__.update(state)
