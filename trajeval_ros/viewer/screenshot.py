"""A screenshot of a picture at first open as a PNG file, without a display."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.writing import temporary_folder, write_whole
from trajeval_ros.viewer.program import free_port, require_recording, rerun_program
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.sinks import LOOPBACK

if TYPE_CHECKING:
    from PIL import Image

_PATIENCE_S = 60.0
_SETTLE_S = 4.0
_LOOK_EVERY_S = 0.25
_WIDTH, _HEIGHT, _MENU = 1600, 900, 36  # the menu also has badges of the machine
_NO_DRIVER = (
    "Rerun's viewer needs a Vulkan driver; install mesa-vulkan-drivers (Debian, Ubuntu), which "
    "needs no graphics card"
)


def save_png(file: Path, png: Path, patience_s: float = _PATIENCE_S) -> None:
    """Write a screenshot of the viewer that has just opened a file (.rrd), without its menu.

    Raises:
        InputError: The viewer did not draw it within `patience_s`, or can't be started.
    """
    sdk()
    require_recording(file)
    from PIL import Image

    with temporary_folder("screenshot") as folder:
        taken = folder / "screenshot.png"
        # `--screenshot-to` takes its picture before the file is loaded.
        with headless_viewer(file, patience_s) as url:
            ask_for_screenshot(url, taken)
        with Image.open(taken) as whole:
            shown = without_menu(whole)
    write_whole(png, lambda path: shown.save(path, "PNG", optimize=True), follow_link=True)


def without_menu(whole: Image.Image) -> Image.Image:
    """Return a screenshot of the viewer without its menu."""
    box = (0, _MENU * whole.height // _HEIGHT, whole.width, whole.height)
    return whole.convert("RGB").crop(box)


def ask_for_screenshot(url: str, png: Path) -> None:
    """Request a screenshot from a viewer."""
    from rerun.experimental import ViewerClient

    try:
        with ViewerClient.connect(url) as viewer:
            # The older name is that of rerun-sdk 0.39.
            look = viewer.get_state if hasattr(viewer, "get_state") else viewer.viewer_state
            while not (state := look()).recordings or state.loading:
                time.sleep(_LOOK_EVERY_S)
            time.sleep(_SETTLE_S)
            viewer.save_screenshot(str(png.resolve()))
    except (OSError, RuntimeError, ValueError) as error:  # the exceptions of the SDK
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"Rerun's viewer took no screenshot ({reason}); close other programs and try again"
        ) from error
    if not png.exists():
        raise InputError(f"Rerun's viewer can't write the screenshot {png}")


@contextmanager
def headless_viewer(file: Path, patience_s: float = _PATIENCE_S) -> Iterator[str]:
    """Run the viewer of a file (.rrd) without a window, and yield its address.

    After `patience_s` the viewer is ended, and connections to it fail, because the SDK has no
    timeout.
    """
    port = free_port()
    silent: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    options = ("--headless", "--hide-welcome-screen", "--window-size", f"{_WIDTH}x{_HEIGHT}")
    with rerun_program(port, *options, str(file), **silent) as viewer:
        late = threading.Event()

        def end() -> None:
            late.set()
            viewer.kill()

        timer = threading.Timer(patience_s, end)
        timer.start()
        try:
            _wait_for(viewer, port)
            yield f"rerun+http://{LOOPBACK}:{port}/proxy"
        except InputError as error:
            if late.is_set():
                raise InputError(
                    f"Rerun's viewer did not draw {file} within {patience_s:g} s; close other "
                    "programs and try again"
                ) from error
            # On a busy machine it may find out after it was connected to.
            with contextlib.suppress(subprocess.TimeoutExpired):
                viewer.wait(_SETTLE_S)
                raise InputError(_NO_DRIVER) from error
            raise
        finally:
            timer.cancel()


def _wait_for(viewer: subprocess.Popen[bytes], port: int) -> None:
    """Wait until the viewer accepts connections and has found a graphics device."""
    while viewer.poll() is None:
        with socket.socket() as probe:
            listens = probe.connect_ex((LOOPBACK, port)) == 0
        with contextlib.suppress(subprocess.TimeoutExpired):
            viewer.wait(_SETTLE_S if listens else _LOOK_EVERY_S)
            break
        if listens:
            return
    raise InputError(_NO_DRIVER)
