"""Kills at random moments: what is left is whole, and the next start puts all in order.

    python tests/support/chaos.py --seed 1 --kills 12 evaluate compare finish simulate replay node

Each verb runs to its end first, which says how long it takes and what it leaves. Then it is
started again and again, in turns from nothing and over results by other settings, and one of four
signals ends it at a random moment. What it left is looked at, and so is what the next start makes
of it. The last line of each verb is what `docs/reliability.md` has.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from comparison_runs import write_runs
from live_runs import Live, messages
from paths import ROOT
from ros_bags import ODOM

from trajeval_ros.io.live.state_file import SUFFIX, read_states

ENDINGS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
PATIENCE_S = 600.0
_LAST_WRITING_S = 60.0
# Of a live run's groundtruth or estimate: fewer may not suffice for an alignment.
FEWEST_POSES = 10
# What no two runs write alike: a recording's id, and when inputs were looked at.
OWN = {"run.rrd", "inputs.json"}
COMPLAINTS = ("Traceback", "Exception ignored", "Fatal Python error")
# Python looks for packages before any line of a program runs, which nothing can catch.
STARTS_UP = ("<frozen site>", "/site.py", "<frozen runpy>")
OWN_LINES = str(ROOT / "trajeval_ros") + os.sep

Listing = dict[str, str]


def trajeval(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "trajeval_ros", *map(str, arguments)]


@dataclass
class Verb:
    """A verb under fire.

    Attributes:
        name: Of the verb.
        command: Returns how to start it by one of two settings, writing to a folder.
        output: Of the folder, where results are; "" for none.
        prepare: Brings what must be there before it starts.
        marker: The file of the results that is there only if all others are.
        kept: Files that other settings leave beside these.
        beside: Started with it, to be ended with it: how.
        then: The next start, where it isn't the same again.
        lasts_s: For how long it runs at least, where that is not known from running it.
    """

    name: str
    command: Callable[[Path, int], list[str]]
    output: str
    prepare: Callable[[Path], object] = lambda folder: None
    marker: str = ""
    kept: str = ""
    beside: Callable[[Path], list[str]] | None = None
    then: Callable[[Path], list[str]] | None = None
    lasts_s: float = 0.0
    faults: list[str] = field(default_factory=list)


class Campaign:
    """Kills of one verb."""

    def __init__(self, verb: Verb, work: Path, random_: random.Random) -> None:
        self.verb, self.work, self.random = verb, work, random_
        self.scratch = work / "tmp"
        self.scratch.mkdir(parents=True)
        self.environment = {
            **os.environ, "TMPDIR": str(self.scratch), "PYTHONPATH": str(ROOT), "CI": "1",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_HOME": str(work / "ros"),
        }  # fmt: skip
        self.statuses: Counter[str] = Counter()

    def run(self, kills: int) -> None:
        """Run it whole by both settings, then kill it."""
        wholes, took_s = [], 0.0
        for setting in (0, 1):
            folder = self._new("whole")
            began = time.monotonic()
            self._complete(folder, setting)
            took_s = time.monotonic() - began  # of the second, which finds files in memory
            wholes.append(self._results(folder))
        took_s = self.verb.lasts_s or took_s
        folder = self._new("killed")
        for kill in range(kills):
            setting = kill % 2
            if kill % 4 == 0:
                folder = self._new("killed")
            self._kill(folder, setting, took_s)
            self._look(folder, wholes)
            self._complete(folder, setting)
            self._compare(folder, wholes[setting])
        print(
            f"{self.verb.name}: {kills} kills within {took_s:.1f} s, "
            f"{dict(sorted(self.statuses.items()))}; {len(self.verb.faults)} faults",
            flush=True,
        )

    def _new(self, name: str) -> Path:
        folder = self.work / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        self.verb.prepare(folder)
        return folder

    def _start(self, command: list[str], log: Path, **more: str) -> subprocess.Popen[bytes]:
        with log.open("wb") as text:
            return subprocess.Popen(
                command, env={**self.environment, **more}, stdin=subprocess.DEVNULL, stdout=text,
                stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip

    def _complete(self, folder: Path, setting: int) -> None:
        """Run it, or what comes after it, to its end."""
        then = self.verb.then
        command = self.verb.command(folder, setting) if then is None else then(folder)
        log = self.work / "log"
        status = self._start(command, log).wait(PATIENCE_S)
        if status and (then is None or not _is_short(folder / self.verb.output)):
            text = log.read_text(errors="replace")
            self._fault(f"the next start ends with {status}: {text[-300:]}")

    def _kill(self, folder: Path, setting: int, took_s: float) -> None:
        ending = self.random.choice(ENDINGS)
        moment = self.random.uniform(0.0, took_s)
        log = self.work / "log"
        process = self._start(self.verb.command(folder, setting), log)
        companion = None
        if self.verb.beside is not None:
            companion = self._start(
                self.verb.beside(folder), self.work / "beside.log", TMPDIR=str(self.work)
            )
        try:
            process.wait(moment)
            how = "ended before"
        except subprocess.TimeoutExpired:
            process.send_signal(ending)
            how = ending.name
        status = process.wait(PATIENCE_S)
        result = folder / self.verb.output / "result.json"
        if self.verb.then is not None and status == 0 and not result.exists():
            self._fault(f"ended in order by {ending.name}, without a result")
        if companion is not None:
            companion.kill()
            companion.wait()
        self.statuses[f"{how}: {status}"] += 1
        text = log.read_text(errors="replace")
        is_started = OWN_LINES in text or not any(item in text for item in STARTS_UP)
        if is_started and any(complaint in text for complaint in COMPLAINTS):
            self._fault(f"{ending.name} after {moment:.2f} s: {text[-600:]}")

    def _look(self, folder: Path, wholes: list[Listing]) -> None:
        """Whatever has its name is whole, be it of these settings or of those before."""
        result = self._results(folder)
        for name, digest in result.items():
            if Path(name).name in OWN or self.verb.then is not None:
                continue
            if digest not in [whole.get(name) for whole in wholes]:
                self._fault(f"{name} is neither whole nor absent")
        marker = result.get(self.verb.marker)
        for whole in wholes if marker else []:
            if marker == whole[self.verb.marker] and not _same(result, whole):
                self._fault(f"{self.verb.marker} is there, and not all that belongs to it")

    def _compare(self, folder: Path, whole: Listing) -> None:
        """After the next start there is what there should be, and nothing else."""
        result = self._results(folder)
        if self.verb.then is None and not _same(result, whole):
            names = {
                item
                for item in result.keys() | whole.keys()
                if result.get(item) != whole.get(item)
            }
            self._fault(f"the next start leaves other results: {sorted(names - OWN)}")
        limit = time.monotonic() + _LAST_WRITING_S
        # A process that the node had started may still write, on its own.
        while (left := self._left(folder)) and self.verb.then and time.monotonic() < limit:
            time.sleep(0.1)
        if left:
            self._fault(f"left behind: {left}")

    def _left(self, folder: Path) -> list[str]:
        return [
            str(path.relative_to(self.work))
            for place in (folder, self.scratch)
            for path in place.rglob("*")
            if ".trajeval-" in path.name or path.name == ".compare.lock"
        ]

    def _results(self, folder: Path) -> Listing:
        """Return checksums by file; pages have the command, with the folder in it."""
        output, name = folder / self.verb.output, str(folder).encode()
        return {
            str(path.relative_to(output)): hashlib.sha256(
                path.read_bytes().replace(name, b"FOLDER")
            ).hexdigest()
            for path in output.rglob("*")
            if path.is_file()
            and ".trajeval-" not in str(path.relative_to(output))
            and path.name != ".compare.lock"
            and not (self.verb.kept and path.match(self.verb.kept))
        }

    def _fault(self, text: str) -> None:
        self.verb.faults.append(text)
        print(f"FAULT {self.verb.name}: {text}", flush=True)


def _same(outcome: Listing, whole: Listing) -> bool:
    """Whether there are the same files with the same bytes, but for those of their own."""
    return outcome.keys() - OWN == whole.keys() - OWN and all(
        outcome[name] == digest for name, digest in whole.items() if name not in OWN
    )


def _is_short(folder: Path) -> bool:
    """Whether a live run ended before there were enough poses to evaluate."""
    counts = [len(read_states(path).states) for path in folder.glob(f"*{SUFFIX}")]
    return len(counts) < 2 or min(counts) < FEWEST_POSES


def verbs(work: Path) -> list[Verb]:
    """Return all verbs with the inputs that they share."""
    gauges = ("se3", "yaw")
    config = write_runs(work / "inputs", trials=1)
    truth = work / "inputs" / "groundtruth" / "hall.txt"
    estimate = work / "inputs" / "good" / "hall_trial0.txt"
    bag = work / "inputs" / "flight"

    def make_bag(folder: Path) -> None:
        del folder
        if not bag.exists():
            subprocess.run(
                trajeval("simulate", bag, "--duration", 10), check=True, stdout=subprocess.DEVNULL
            )

    def node(folder: Path, setting: int) -> list[str]:
        values = {
            "groundtruth_topic": "/groundtruth/pose", "estimate_topics": ["/vio/odometry"],
            "gauge": gauges[setting], "lengths": "4", "autosave_period": 2,
            "output": str(folder / "out"),
        }  # fmt: skip
        shutil.rmtree(folder / "out", ignore_errors=True)
        words = [
            w for name, value in values.items() for w in ("-p", f"{name}:={json.dumps(value)}")
        ]
        return trajeval("evaluator", "--ros-args", *words)

    def lay_pairs(folder: Path) -> None:
        live = Live(folder / "run", ODOM)
        live.feed(messages(9))
        live.end()

    return [
        Verb(
            "evaluate",
            lambda folder, setting: trajeval(
                "evaluate", "-g", truth, "-e", estimate, "--gauge", gauges[setting], "--lengths",
                "4,8", "--output", folder / "out"),
            "out",
            marker="result.json",
        ),
        Verb(
            "compare",
            lambda folder, setting: trajeval(
                "compare", config, "--gauge", gauges[setting], "--workers", 2, "--output",
                folder / "out"),
            "out",
            kept="runs/*.records",
        ),
        Verb(
            "finish",
            lambda folder, _: trajeval(
                "finish", folder / "run", "--output", folder / "run", "--quiet"),
            "run",
            lay_pairs,
            marker="result.json",
        ),
        Verb(
            "simulate",
            lambda folder, setting: trajeval(
                "simulate", folder / "flight", "--seed", setting, "--duration", 10, "--overwrite"),
            "flight",
            marker="metadata.yaml",
        ),
        Verb(
            "replay",
            lambda folder, setting: trajeval(
                "replay", bag, "--rate", 5 + setting, "--wait-for-subscribers", 0),
            "",
            make_bag,
        ),
        Verb(
            "node",
            node,
            "out",
            make_bag,
            beside=lambda folder: trajeval("replay", bag, "--wait-for-subscribers", 60),
            then=lambda folder: trajeval(
                "finish", folder / "out", "--output", folder / "out", "--quiet"),
            lasts_s=25.0,
        ),
    ]  # fmt: skip


def main() -> int:
    """Run the campaign; returns 1 if anything was not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verbs", nargs="+")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kills", type=int, default=200, help="of each verb")
    given = parser.parse_args()
    # In the background or under nohup they would be ignored, and so by what is started here.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    faults = 0
    with tempfile.TemporaryDirectory(prefix="chaos_") as name:
        work = Path(name)
        for place, verb in enumerate(verbs(work)):
            if verb.name in given.verbs:
                seed = random.Random(1000 * given.seed + place)
                Campaign(verb, work / verb.name, seed).run(given.kills)
                faults += len(verb.faults)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
