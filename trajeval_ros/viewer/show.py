"""A file in Rerun's viewer: in a window, or as a page for a browser."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.viewer.program import free_port, rerun_program
from trajeval_ros.viewer.sinks import LOOPBACK

_MAGIC = b"RRF"
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def has_display() -> bool:
    """Return whether a window can be opened; always true on systems other than Linux."""
    return sys.platform != "linux" or any(map(os.environ.get, _DISPLAYS))


def show(file: Path, *, in_browser: bool = False) -> None:
    """Open a file (.rrd) in the viewer, and wait until it is closed.

    Args:
        file: The file to show.
        in_browser: Whether to serve the viewer as a web page on this machine, until Ctrl-C.

    Raises:
        InputError: rerun-sdk is not installed, the file can't be read or is none of Rerun's,
            there is no display, or the viewer fails.
    """
    try:
        with file.open("rb") as opened:
            magic = opened.read(len(_MAGIC))
    except OSError as error:
        raise InputError(f"{file} can't be read: {reason_of(error)}") from error
    if magic != _MAGIC:
        raise InputError(f"{file} is not a Rerun file; give a .rrd file or an output folder")
    if not (in_browser or has_display()):
        raise InputError("no display found; use --web and open the page in a browser")
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
