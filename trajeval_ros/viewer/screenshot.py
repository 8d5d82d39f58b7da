"""The first screen of a picture as a PNG, without a display."""

from __future__ import annotations

import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.viewer.program import free_port, rerun_program
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.sinks import LOOPBACK

_PATIENCE_S = 60.0
_SETTLE_S = 4.0
_LOOK_EVERY_S = 0.25
_SIZE = "1600x900"


def save_png(file: Path, png: Path) -> None:
    """Write what the viewer shows of a file (.rrd) at first open.

    Raises:
        InputError: rerun-sdk is not installed, or there is nothing to draw with.
    """
    sdk()
    from rerun.experimental import ViewerClient

    # `--screenshot-to` takes its picture before the file is loaded.
    with headless_viewer(file) as url, ViewerClient.connect(url) as viewer:
        time.sleep(_SETTLE_S)
        viewer.save_screenshot(str(png.resolve()))


@contextmanager
def headless_viewer(file: Path) -> Iterator[str]:
    """Run the viewer of a file (.rrd) without a window; yields where it listens.

    Raises:
        InputError: rerun-sdk is not installed, or there is nothing to draw with.
    """
    port = free_port()
    silent: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    options = ("--headless", "--hide-welcome-screen", "--window-size", _SIZE)
    with rerun_program(port, *options, str(file), **silent) as viewer:
        _wait_for(viewer, port)
        yield f"rerun+http://{LOOPBACK}:{port}/proxy"


def _wait_for(viewer: subprocess.Popen[bytes], port: int) -> None:
    """Wait until the viewer listens, and has found what to draw with."""
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until:
        try:
            socket.create_connection((LOOPBACK, port), _LOOK_EVERY_S).close()
        except OSError:
            time.sleep(_LOOK_EVERY_S)
        else:
            time.sleep(_SETTLE_S)
            if viewer.poll() is None:
                return
        if viewer.poll() is not None:
            break
    raise InputError(
        "Rerun's viewer finds nothing to draw with; it needs a Vulkan driver: that of Debian and "
        "Ubuntu, mesa-vulkan-drivers, needs no graphics card"
    )
