"""The pictures of README.md, drawn by the commands that it shows.

    readme_pictures.py
    readme_pictures.py --animation run.rrd

writes them to docs/images. The second form draws the animation of a live run: that of README.md is
of EuRoC MH_01 with OpenVINS, replayed to the node.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from waiting import until

from trajeval_ros.viewer.screenshot import headless_viewer, without_menu

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
PICTURES = ("trajectory_top.png", "rerun.png")
_BLOCK = 20  # pixels
ANIMATION = "live.webp"
_FRAMES, _FRAME_MS = 50, 200
_PATIENCE_S = 600.0  # for all frames
_WIDTH, _QUALITY = 1100, 72  # below 2 MB, and the text can be read


def draw(folder: Path) -> None:
    """Write all pictures to a folder."""
    flight, live = folder / "flight", folder / "live"
    live.mkdir()
    sources = ["-g", f"{flight}:/groundtruth/pose", "-e", f"{flight}:/vio/odometry"]
    text = ["--modality", "stereo-inertial", "--output", str(folder), "--quiet"]
    driver = str(Path(__file__).with_name("rerun_driver.py"))
    trajeval = [sys.executable, "-m", "trajeval_ros"]
    shown = ["view", str(live / "run.rrd"), "--screenshot", str(folder / "rerun.png")]
    for command in (
        [*trajeval, "simulate", str(flight)],
        [*trajeval, "evaluate", *sources, *text],
        [sys.executable, driver, "file", str(live), "120", "20"],
        [*trajeval, *shown],
    ):
        environment = {**os.environ, "CI": "1", "PYTHONPATH": str(ROOT)}
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)


def difference(one: Path, other: Path) -> float:
    """Return the largest difference of two pictures over blocks of pixels, 0 to 255."""
    pictures = [Image.open(item).convert("RGB") for item in (one, other)]
    if pictures[0].size != pictures[1].size:
        return 255.0
    size = (pictures[0].width // _BLOCK, pictures[0].height // _BLOCK)
    means = [np.asarray(picture.resize(size, Image.Resampling.BOX), float) for picture in pictures]
    return float(np.abs(means[0] - means[1]).max())


def animate(recording: Path, target: Path) -> None:
    """Draw the picture of a live run at equally spaced times, as an animated WebP of 10 s."""
    from rerun.experimental import ViewerClient

    frames = []
    with headless_viewer(recording, _PATIENCE_S) as url, ViewerClient.connect(url) as viewer:
        until(lambda: is_loaded(viewer), "the viewer has loaded the recording")
        timeline = viewer.get_state().recordings[0].timelines[0]
        for stamp in np.linspace(timeline.start, timeline.end, _FRAMES + 1, dtype=np.int64)[1:]:
            viewer.set_time(
                timeline.name, timestamp=np.datetime64(int(stamp), "ns"), play_state="paused"
            )
            viewer.take_screenshot()  # the first one still has parts of the former time
            with Image.open(io.BytesIO(viewer.take_screenshot())) as whole:
                shown = without_menu(whole)
            height = round(shown.height * _WIDTH / shown.width)
            frames.append(shown.resize((_WIDTH, height), Image.Resampling.LANCZOS))
    frames[0].save(
        target,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=_FRAME_MS,
        loop=0,
        quality=_QUALITY,
        method=6,
    )


def is_loaded(viewer: Any) -> bool:
    """Return whether a viewer shows a recording."""
    state = viewer.get_state()
    return bool(state.recordings) and not state.loading


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the pictures of README.md.")
    parser.add_argument("--animation", metavar="RUN.rrd", type=Path)
    options = parser.parse_args()
    if options.animation:
        animate(options.animation, IMAGES / ANIMATION)
        sys.exit()
    with tempfile.TemporaryDirectory() as temporary:
        draw(Path(temporary))
        for name in PICTURES:
            (IMAGES / name).write_bytes((Path(temporary) / name).read_bytes())
