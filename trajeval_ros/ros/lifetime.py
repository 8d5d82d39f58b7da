"""From `rclpy.init` to shutdown, with signals that request an orderly end."""

from __future__ import annotations

import ctypes
import json
import re
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.ros.terminal import leave_lost_terminal

_ARENAS = -8  # M_ARENA_MAX of mallopt(3)


def use_one_heap() -> None:
    """Let all threads allocate from one heap; call it before the first thread.

    By default, glibc has a heap per thread. Blocks that one thread allocates and another one frees
    split them, so that the memory of a node that runs for hours doubles. Other C libraries have no
    such setting.
    """
    if sys.platform == "linux":
        with suppress(AttributeError):
            ctypes.CDLL(None).mallopt(_ARENAS, 1)


class StopSignal:
    """Whether SIGINT, SIGTERM or SIGHUP has arrived.

    A plain flag: a handler runs between any two instructions of the main thread, so it must not
    acquire a lock, as `threading.Event.set` does.
    """

    is_asked_for = False

    def __call__(self, *_: object) -> None:
        """Handle a signal."""
        self.is_asked_for = True
        leave_lost_terminal()


def _endings() -> list[signal.Signals]:
    """Return the signals that request an end.

    SIGHUP is sent if the terminal is closed, as when an SSH session ends. If it is ignored
    (`nohup`), it stays ignored.
    """
    endings = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        endings.append(signal.SIGHUP)
    return endings


_LIST = re.compile(r"([\w/.~]+:=)\[([^\[\]\"']*:[^\[\]\"']*)\]")


def quoted(arguments: Sequence[str]) -> list[str]:
    """Return ROS arguments with quotes in lists whose items contain a colon.

    YAML allows a colon in a plain item, as in [/odom,/tf:odom.base_link]; the parser of ROS fails.
    """

    def with_quotes(match: re.Match[str]) -> str:
        return f"{match[1]}{json.dumps([word.strip() for word in match[2].split(',')])}"

    return [
        _LIST.sub(with_quotes, argument) if _LIST.fullmatch(argument) else argument
        for argument in arguments
    ]


@contextmanager
def ros(arguments: Sequence[str] = ()) -> Iterator[StopSignal]:
    """Run ROS in this process, until the end of the block.

    The context stays valid after a signal, so the last results can be published and written.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    stop = StopSignal()
    before: dict[signal.Signals, Any] = {
        ending: signal.signal(ending, stop) for ending in _endings()
    }
    try:
        try:
            rclpy.init(args=quoted(arguments), signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:  # of several private kinds
            reason = " ".join(str(error).split())
            raise SettingsError(
                f"ROS can't start with {' '.join(arguments)}: {reason}; in lists, put topics with "
                'a colon in quotes, as in ["/odom", "/tf:odom.base_link"]'
            ) from error
        yield stop
    finally:
        rclpy.try_shutdown()
        for item, handler in before.items():
            signal.signal(item, handler)
