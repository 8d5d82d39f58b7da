"""What a whole process costs: CPU time of user and system, and peak memory.

The kernel counts a child's peak memory from that of the process that started it, so whoever
measures stays small: the modules imported here and in `benchmarks.run` don't load numpy.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

KERNEL = "OPENBLAS_CORETYPE"  # the processor that numpy's linear algebra is to be written for


@dataclass(frozen=True)
class Cost:
    """What one process, or several in a row, used.

    Attributes:
        cpu_s: User and system time, all threads.
        wall_s: Time that passed.
        peak_mib: Largest resident set, of the largest of them.
        output: What it printed on stdout.
    """

    cpu_s: float
    wall_s: float
    peak_mib: float
    output: str = ""

    def __add__(self, after: Cost) -> Cost:
        """Return the cost of running one after the other."""
        return Cost(
            self.cpu_s + after.cpu_s,
            self.wall_s + after.wall_s,
            max(self.peak_mib, after.peak_mib),
            self.output + after.output,
        )


class CommandFailedError(Exception):
    """A measured command ended with an error: its time means nothing."""


def run(command: Sequence[str], environment: Mapping[str, str]) -> Cost:
    """Run a command to its end and return what it cost."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=errors
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        errors.seek(0)
        if process.returncode != 0:
            tail = errors.read().decode(errors="replace").strip()[-500:]
            raise CommandFailedError(
                f"{' '.join(command)} ended with {process.returncode}: {tail}"
            )
        text = output.read().decode(errors="replace")
    return Cost(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024.0, text)


def environment(home: Path) -> dict[str, str]:
    """Return the environment for all that is measured: a home of its own, bytecode cached.

    An inherited PYTHONDONTWRITEBYTECODE would make the checkout's own sources be compiled
    at every start, and theirs in site-packages not.
    """
    names = ("PATH", "LANG", "TMPDIR", KERNEL)
    kept = {name: os.environ[name] for name in names if name in os.environ}
    return {**kept, "HOME": str(home)}


def median_cost(costs: Sequence[Cost]) -> Cost:
    """Return the medians of each figure; the output is the last one's."""
    return Cost(
        median(cost.cpu_s for cost in costs),
        median(cost.wall_s for cost in costs),
        median(cost.peak_mib for cost in costs),
        costs[-1].output,
    )
