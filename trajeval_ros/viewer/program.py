"""Rerun's own program, which shows files and recordings, as a process."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.sinks import LOOPBACK

_PATIENCE_S = 5.0
_NAME = "rerun.exe" if sys.platform == "win32" else "rerun"


def free_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


@contextmanager
def rerun_program(port: int, *arguments: str, **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run the program during the block.

    Args:
        port: Port of its server, on the loopback address only.
        arguments: Its other arguments.
        options: Arguments of `subprocess.Popen`.

    Raises:
        InputError: rerun-sdk is not installed.
    """
    sdk()
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    binary = bundled if bundled.exists() else folder / _NAME
    # If its Python wrapper is ended, the program continues; so it is started directly. With CI
    # set, it sends no usage statistics.
    with _sigterm_as_exit():
        process = subprocess.Popen(
            [str(binary), "--bind", LOOPBACK, "--port", str(port), *arguments],
            env={"RUST_LOG": "error", **os.environ, "CI": "1"},
            **options,
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def _sigterm_as_exit() -> Iterator[None]:
    """Raise SystemExit at SIGTERM in the block, so that processes started in it are ended.

    This has an effect only in the main thread, and only if SIGTERM has no other handler.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _exit(number: int, _: object) -> NoReturn:
    raise SystemExit(128 + number)
