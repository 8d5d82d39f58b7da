"""A live picture that never blocks the node: a thread per sink, behind a queue that drops.

Rerun's `log` may block for seconds, or forever if a viewer connects and does not read. A file of
the same recording then stops growing, too. Therefore every sink has its own recording, thread and
queue, and filling the queue never waits.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from trajeval_ros.exceptions import TrajevalError, describe_defect

_MOST_WAITING = 2000  # about a minute of a run
_LOOK_EVERY_S = 0.1
_PATIENCE_S = 5.0
_TELL_DROPS_EVERY_S = 10.0

_SWITCH_S = 0.0005

Job = Callable[[], object]


def lower_priority() -> None:
    """Switch between Python's threads ten times as often as by default.

    Otherwise a drawing thread delays the thread that receives messages by 5 ms.
    """
    sys.setswitchinterval(_SWITCH_S)


class Sink(Protocol):
    """The destination of a recording."""

    name: str  # name for messages
    absence: str  # the sentence about a receiver that is not there
    check_every_s: float  # period of `check`, seconds

    def open(self, blueprint: Any) -> Any | None:
        """Return a new recording; None if there is no receiver yet."""

    def check(self, recording: Any) -> bool:
        """Write the data so far; return False if the sink is lost and may be opened again."""

    def close(self, recording: Any) -> None:
        """Write everything, and end."""


class Drawing(Protocol):
    """Draws on a recording, and stores the data while there is none."""

    blueprint: Any

    def begin(self, recording: Any) -> None:
        """Draw on a recording from now on."""

    def leave(self) -> None:
        """Stop drawing."""

    def finish(self) -> None:
        """Draw the end."""

    def dropped(self, count: int) -> None:
        """Show the number of updates that were not drawn."""


class DrawingThread:
    """Draws on a sink, on its own thread."""

    def __init__(self, sink: Sink, drawing: Drawing, after: DrawingThread | None = None) -> None:
        self.name = sink.name
        self.dropped = 0  # number of jobs that did not reach the sink
        self.trouble = ""  # why the sink receives no more data; empty while it may
        self.absence = ""  # why the sink has no receiver now; empty if it has one
        self._sink, self._drawing = sink, drawing
        self._jobs: deque[Job] = deque()
        self._closing = threading.Event()
        self._after = after
        self._recording: Any = None
        self._reported_dropped = 0
        self._report_at = 0.0
        self._thread = threading.Thread(target=self._work, name=f"rerun {sink.name}", daemon=True)
        self._thread.start()

    def put(self, job: Job) -> None:
        """Add a drawing job, without waiting."""
        # The thread is not woken: this would release the interpreter in the middle of a callback.
        if len(self._jobs) < _MOST_WAITING:
            self._jobs.append(job)
        else:
            self.dropped += 1

    def end(self) -> None:
        """Stop without waiting."""
        self._closing.set()

    def wait_for_end(self) -> None:
        """Wait until another thread has ended it, and then for a few seconds at most."""
        self._closing.wait()
        self._thread.join(_PATIENCE_S)

    def close(self) -> bool:
        """Write everything and end; return whether this was possible in a few seconds."""
        self.end()
        self._thread.join(_PATIENCE_S)
        return not self._thread.is_alive()

    def _work(self) -> None:
        if self._after is not None:
            self._after.wait_for_end()
            self._after = None
        check_at = 0.0
        while not self._closing.wait(_LOOK_EVERY_S) or self._jobs:
            if self.trouble:
                self.dropped += len(self._jobs)
                self._jobs.clear()
                continue
            if time.monotonic() >= check_at:
                self._guarded(self._tend)
                check_at = time.monotonic() + self._sink.check_every_s
            while self._jobs and time.monotonic() < check_at:
                if self._recording is None:  # nothing to draw on
                    self.dropped += 1
                    self._reported_dropped += 1
                self._guarded(self._jobs.popleft())
            if time.monotonic() >= self._report_at:
                self._guarded(self._report_dropped)
        self._guarded(self._report_dropped)
        if self._recording is not None:
            self._guarded(self._drawing.finish)
            self._guarded(lambda: self._sink.close(self._recording))

    def _tend(self) -> None:
        """Open the sink, or check it."""
        if self._recording is None:
            recording = self._sink.open(self._drawing.blueprint)
            if recording is not None:
                self._recording = recording
                self._drawing.begin(recording)
        elif not self._sink.check(self._recording):
            self._forget()
        self.absence = self._sink.absence if self._recording is None else ""

    def _report_dropped(self) -> None:
        """Show how much was dropped, if that has changed."""
        if self._recording is not None and self.dropped > self._reported_dropped:
            self._reported_dropped = self.dropped
            self._report_at = time.monotonic() + _TELL_DROPS_EVERY_S
            self._drawing.dropped(self.dropped)

    def _guarded(self, action: Job) -> None:
        """Run a job; an exception ends the picture, but not the node."""
        try:
            action()
        except TrajevalError as error:
            self.trouble = str(error)
            self._forget()
        except Exception as error:
            self.trouble = describe_defect(error)
            self._forget()

    def _forget(self) -> None:
        recording, self._recording = self._recording, None
        self._drawing.leave()
        if recording is not None:
            recording.disconnect()
