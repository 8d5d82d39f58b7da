"""A campaign of changed inputs of all formats, from a seed: `make fuzz`.

Whatever the input, its reader gives an answer or one sentence, within 20 seconds and a gigabyte of
memory, and no pose is lost without a word: what is neither read nor counted as dropped is told of
as damage. Strictly read, nothing may be lost at all.

Usage: python tests/support/fuzz_structures.py [OPTIONS]

Options: [--seed 0] [--count 10000] [--format mcap] [--only 17]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_changes import Changed
from fuzz_formats import FORMATS

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.remarks import Level

LONGEST_S = 20
ROOM = 1 << 30  # bytes beside what is taken when the campaign begins


class Hang(BaseException):
    """An input takes too long; not an Exception, since readers catch those."""


def verdict_on(changed: Changed, *, strict: bool) -> str:
    """Return how an input was taken.

    Raises:
        AssertionError: Poses were lost without a word, or a refusal isn't one sentence.
        Exception: Whatever else the reader raises.
    """
    try:
        read = changed.read(strict)
    except TrajevalError as error:
        text = str(error)
        assert text, "nothing is said"
        assert "\n" not in text, f"more than a line is said: {text}"
        return "refused"
    if read is None:
        return "read"
    lost = changed.poses - len(read) - sum(read.reading.dropped.values())
    assert lost <= 0 or (read.reading.messages(Level.ERROR) and not strict), (
        f"{lost} poses were lost without a word"
    )
    for column in (read.positions, read.quaternions):
        assert column is None or np.isfinite(column).all(), "a number is none"
    is_told = read.reading.messages(Level.ERROR) or read.reading.dropped
    return "read, with a word" if is_told else "read"


def one_input(name: str, seed: int, number: int) -> tuple[str, float]:
    """Make and read an input; returns how it was taken, and the seconds that reading took."""
    random = np.random.default_rng([seed, list(FORMATS).index(name), number])
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        changed = FORMATS[name](random, Path(folder))
        begin = time.perf_counter()
        signal.alarm(LONGEST_S)
        try:
            verdicts = [verdict_on(changed, strict=strict) for strict in (True, False)]
        except (Exception, Hang) as error:
            error.add_note(changed.what) if hasattr(error, "add_note") else None
            raise
        finally:
            signal.alarm(0)
    return verdicts[-1], time.perf_counter() - begin


def campaign(names: list[str], seed: int, numbers: range) -> int:
    """Read inputs of some formats and print what came of it; returns the number of failures."""
    failures = 0
    print(f"{'format':8} {'inputs':>6} {'refused':>8} {'read':>6} {'with a word':>12} "
          f"{'slowest':>8} {'failures':>9}")  # fmt: skip
    for name in names:
        taken: Counter[str] = Counter()
        slowest, failed = 0.0, 0
        for number in numbers:
            try:
                verdict, seconds = one_input(name, seed, number)
            except (Exception, Hang):
                failed += 1
                print(f"--- {name}: --seed {seed} --format {name} --only {number}")
                traceback.print_exc(file=sys.stdout)
                continue
            taken[verdict] += 1
            slowest = max(slowest, seconds)
        counts = [taken[item] for item in ("refused", "read", "read, with a word")]
        print(f"{name:8} {len(numbers):6} {counts[0]:8} {counts[1]:6} {counts[2]:12} "
              f"{slowest:6.2f} s {failed:9}", flush=True)  # fmt: skip
        failures += failed
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{len(names) * len(numbers)} inputs, {failures} failures, at most {peak:.0f} MB in all")
    return failures


def hang(*_: Any) -> None:
    raise Hang(f"longer than {LONGEST_S} s")


def bounded() -> None:
    """Bound the memory of this process, and the time of an input."""
    with Path("/proc/self/statm").open(encoding="ascii") as file:
        taken = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, hang)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=10_000, help="of inputs, of all formats")
    parser.add_argument("--format", choices=list(FORMATS))
    parser.add_argument("--only", type=int, help="the number of one input")
    given = parser.parse_args()
    names = [given.format] if given.format else list(FORMATS)
    numbers = range(-(-given.count // len(names)))
    if given.only is not None:
        numbers = range(given.only, given.only + 1)
    bounded()
    with warnings.catch_warnings(), contextlib.suppress(KeyboardInterrupt):
        warnings.simplefilter("ignore")
        return min(campaign(names, given.seed, numbers), 1)
    return 130


if __name__ == "__main__":
    sys.exit(main())
