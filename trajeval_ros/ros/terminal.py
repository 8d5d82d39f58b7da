"""One status line on a terminal, updated every second; otherwise periodic lines of the log."""

from __future__ import annotations

import contextlib
import os
import stat
import sys
import time

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import counted, whole_percent
from trajeval_ros.online.reports import Snapshot

_LOG_EVERY_S = 10.0
_OLD_S = 3.0  # the error of an older pair is not shown as the present one
_BEGIN_ANEW = "\r\x1b[K"


class StatusLine:
    """Writes to stderr, as the log does, so that results can be piped."""

    def __init__(self) -> None:
        self._width = _width()
        self._shown = False
        self._log_at = 0.0

    def show(self, parts: list[str]) -> str | None:
        """Show the status of all estimates, cut to the terminal's width.

        Returns:
            The whole line for the log, periodically, if there is no terminal.
        """
        text = one_line("  |  ".join(parts))
        if not self._width:
            if not parts or time.monotonic() < self._log_at:
                return None
            self._log_at = time.monotonic() + _LOG_EVERY_S
            return text
        self._width = _width() or self._width
        text = text if len(text) < self._width else text[: self._width - 2] + "…"
        self._write(_BEGIN_ANEW + text)
        self._shown = True
        return None

    def clear(self) -> None:
        """Clear the line before other output."""
        if self._shown:
            self._write(_BEGIN_ANEW)
            self._shown = False

    def _write(self, text: str) -> None:
        """Write to the terminal, which may have been closed."""
        try:
            sys.stderr.write(text)
            sys.stderr.flush()
        except OSError:
            self._width = 0


def _width() -> int:
    """Return the number of columns of the terminal; 0 if there is none, or it has no size.

    `ros2 launch` with emulate_tty makes a terminal without a size, and prefixes its lines.
    """
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns if sys.stderr.isatty() else 0
    except (OSError, ValueError):
        return 0


def leave_lost_terminal() -> None:
    """Discard output if the terminal was closed, as when an SSH session ends.

    Writing to it fails, and would end this and other processes before their work is done.
    """
    for stream in (1, 2):
        with contextlib.suppress(OSError):
            if stat.S_ISCHR(os.fstat(stream).st_mode) and not os.isatty(stream):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream)
                os.close(nowhere)


def summary(
    name: str,
    snapshot: Snapshot,
    window: str,
    newest_m: float | None,
    missing: str,
    *,
    unpaired_s: float = 0.0,
) -> str:
    """Return one estimate's part of the line; the newest pair was made `unpaired_s` ago."""
    if not snapshot.pairs:
        waiting = f"{counted(snapshot.waiting, 'pose')} waiting for groundtruth"
        return f"{name}: " + (
            f"no messages yet on {missing}" if missing else f"no pairs yet, {waiting}"
        )
    window = "whole run" if window == "0" else window
    if snapshot.alignment is None or snapshot.window_position_rmse_m is None:
        return f"{name}: warming up, {snapshot.warming_up}"
    words = [
        f"{name}: {counted(snapshot.pairs, 'pair')}, ATE {snapshot.window_position_rmse_m:.3f} m"
    ]
    rotation = snapshot.ate.get("rotation_deg")
    if rotation is not None:
        words.append(f"{rotation.rmse:.2f} deg")
    words.append(f"({window})")
    if unpaired_s > _OLD_S:
        words.append(f"last pair {unpaired_s:.0f} s ago")
    elif newest_m is not None:
        words.append(f"now {newest_m:.3f} m")
    ended = [(length, errors) for length, errors in snapshot.relative.items() if errors.count]
    if ended:
        length, errors = ended[-1]
        words.append(f"RE {length} {errors.position_m:.3f} m")
    if snapshot.estimate_coverage is not None and snapshot.estimate_coverage < 0.995:
        words.append(f"{whole_percent(snapshot.estimate_coverage)} covered")
    return " ".join(words)
