"""A file in Rerun's viewer: in a window, or as a page for a browser."""

from __future__ import annotations

import sys
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.viewer.program import free_port, rerun_program
from trajeval_ros.viewer.sinks import LOOPBACK


def show(file: Path, *, in_browser: bool = False) -> None:
    """Open a file (.rrd) in the viewer, and wait until it is closed.

    Args:
        file: What to show.
        in_browser: Serve the viewer as a web page on this machine instead, until Ctrl-C.

    Raises:
        InputError: rerun-sdk is not installed, the file can't be read, or the viewer fails.
    """
    try:
        file.open("rb").close()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{file} can't be read: {reason}") from error
    port, page = free_port(), free_port()
    options = ["--serve-web", "--web-viewer-port", str(page)] if in_browser else []
    try:
        with rerun_program(port, *options, str(file)) as viewer:
            if in_browser:
                source = f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"
                address = f"http://{LOOPBACK}:{page}/?url={source}"
                print(f"open {address} in a browser; Ctrl-C ends it")
                sys.stdout.flush()
            status = viewer.wait()
    except KeyboardInterrupt:
        return
    if status:
        hint = "" if in_browser else "; without a display, use --web"
        raise InputError(f"Rerun's viewer ended with status {status}{hint}")
