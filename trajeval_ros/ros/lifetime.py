"""From `rclpy.init` to shutdown, with signals that request an orderly end."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.ros.terminal import leave_lost_terminal


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


@contextmanager
def ros(arguments: Sequence[str] = ()) -> Iterator[StopSignal]:
    """Run ROS in this process, until the end of the block.

    The context stays valid after a signal, so the last results can be published and written.

    Args:
        arguments: ROS arguments, from `--ros-args` on.

    Raises:
        SettingsError: ROS rejects the arguments.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    stop = StopSignal()
    before: dict[signal.Signals, Any] = {each: signal.signal(each, stop) for each in _endings()}
    try:
        try:
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:  # of several private kinds
            said = " ".join(str(error).split())
            raise SettingsError(f"ROS can't start with {' '.join(arguments)}: {said}") from error
        yield stop
    finally:
        rclpy.try_shutdown()
        for each, handler in before.items():
            signal.signal(each, handler)
