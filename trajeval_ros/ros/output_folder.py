"""The output folder of a live run, and the process that evaluates it repeatedly.

The evaluation of a long run would delay messages in the node. Therefore another process does it.
It reads the states from disk, like `trajeval finish`.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.io.writing import collect_leftovers

MOST_SHARE = 0.05  # of a core, for periodic saving
_NICE = 10


def make_folder(name: str) -> Path:
    """Create the folder for a run; if it exists, with a number appended to its name."""
    named = Path(name or f"trajeval_{datetime.now():%Y_%m_%d-%H_%M_%S}").expanduser().resolve()
    folder, number = named, 1
    while folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        number += 1
        folder = named.with_name(f"{named.name}_{number}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output folder {folder} can't be created: {reason_of(error)}") from error
    return folder


class Finisher:
    """Runs `trajeval finish` on a folder, one process at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.trouble = ""  # why the last process failed; empty if it did not
        self._process: subprocess.Popen[str] | None = None
        self._began = self._took_s = 0.0
        self._next_at = 0.0

    @property
    def is_busy(self) -> bool:
        """Whether a process is writing."""
        return self._process is not None

    @property
    def is_due(self) -> bool:
        """Whether writing again now stays within the limit of CPU time."""
        return not self.is_busy and time.monotonic() >= self._next_at

    @property
    def least_period_s(self) -> float:
        """Shortest period of writing within the limit of CPU time, seconds."""
        return self._took_s / MOST_SHARE

    def save(self) -> None:
        """Start a process that writes result.json."""
        self._start(["--json", str(self.folder / "result.json")], quiet=True)

    def poll(self) -> bool:
        """Return whether writing has ended since the last call; `trouble` has its error."""
        if self._process is None or self._process.poll() is None:
            return False
        self._end()
        return True

    def finish(self, *, quiet: bool) -> bool:
        """Write everything, including figures, and wait; return whether it was written.

        Without `quiet`, tables are printed.
        """
        self._finish(quiet=quiet)
        return self._end()

    def finish_alone(self) -> None:
        """Start to write everything, without waiting."""
        self._finish(quiet=True)

    def _finish(self, *, quiet: bool) -> None:
        """Start to write everything; a process that is writing has older pairs, and is ended."""
        if self._process is not None:
            self._process.terminate()
            self._end()
            collect_leftovers(self.folder)
        self._start(["--output", str(self.folder)], quiet=quiet)

    def _start(self, options: list[str], *, quiet: bool) -> None:
        command = [sys.executable, "-m", "trajeval_ros", "finish", str(self.folder), *options]
        command += ["--quiet"] if quiet else []
        self._began = time.monotonic()
        # In a new session, Ctrl-C in the terminal does not interrupt the process.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE if quiet else None,
            text=True,
            start_new_session=True,
        )
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, self._process.pid, _NICE)

    def _end(self) -> bool:
        assert self._process is not None
        _, printed = self._process.communicate()
        status, self._process = self._process.returncode, None
        self._took_s = time.monotonic() - self._began
        self._next_at = self._began + max(self.least_period_s, self._took_s)
        lines = [line.removeprefix("trajeval: ") for line in (printed or "").splitlines()]
        self.trouble = "" if status == 0 else (lines[-1] if lines else f"exit status {status}")
        return status == 0
