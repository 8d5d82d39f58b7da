"""Rerun's viewer as a process, for files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.sinks import LOOPBACK, PORT

WEB_PORT = 9090


def show(file: Path, *, in_browser: bool = False) -> None:
    """Open a file (.rrd) in the viewer, and wait until it is closed.

    Args:
        file: What to show.
        in_browser: Serve the viewer as a web page on this machine instead, until Ctrl-C.

    Raises:
        InputError: rerun-sdk is not installed, the file can't be read, or the viewer fails.
    """
    sdk()
    try:
        file.open("rb").close()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{file} can't be read: {reason}") from error
    options = ["--serve-web", "--web-viewer-port", str(WEB_PORT)] if in_browser else []
    # It would listen on all of the machine's addresses.
    address = ["--bind", LOOPBACK, "--port", str(PORT)]
    if in_browser:
        source = f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{PORT}%2Fproxy"
        print(f"open http://{LOOPBACK}:{WEB_PORT}/?url={source} in a browser; Ctrl-C ends it")
        sys.stdout.flush()
    try:
        status = subprocess.call([sys.executable, "-m", "rerun", *options, *address, str(file)])
    except KeyboardInterrupt:
        return
    if status:
        hint = "is one of its ports taken?" if in_browser else "without a display, use --web"
        raise InputError(f"Rerun's viewer ended with status {status}; {hint}")
