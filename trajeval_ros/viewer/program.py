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

from trajeval_ros.exceptions import InputError, reason_of
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
    """Run the program during the block."""
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


_MAGIC = b"RRF"
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def has_display() -> bool:
    """Return whether a window can be opened; always true on systems other than Linux."""
    return sys.platform != "linux" or any(map(os.environ.get, _DISPLAYS))


def require_recording(file: Path) -> None:
    """Check that a file is one of Rerun (.rrd)."""
    try:
        with file.open("rb") as opened:
            magic = opened.read(len(_MAGIC))
    except OSError as error:
        raise InputError(f"{file} can't be read: {reason_of(error)}") from error
    if magic != _MAGIC:
        raise InputError(f"{file} is not a Rerun file; give a .rrd file or an output folder")


def show(file: Path, *, in_browser: bool = False) -> None:
    """Open a file (.rrd) in the viewer, and wait until it is closed."""
    require_recording(file)
    if not (in_browser or has_display()):
        raise InputError(
            "no display found; use --web and open the page in a browser, or --screenshot FILE.png"
        )
    port, page = free_port(), free_port()
    options = ["--serve-web", "--web-viewer-port", str(page)] if in_browser else []
    try:
        with rerun_program(port, *options, str(file)) as viewer:
            if in_browser:
                source = f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"
                address = f"http://{LOOPBACK}:{page}/?url={source}"
                print(f"open {address} in a browser; stop with Ctrl-C")
                sys.stdout.flush()
            status = viewer.wait()
    except KeyboardInterrupt:
        return
    if status:
        raise InputError(f"Rerun's viewer exited with status {status}")
