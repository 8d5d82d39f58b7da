"""The pictures of README.md, drawn by the commands that it shows.

    readme_pictures.py

writes them to docs/images.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
PICTURES = ("trajectory_top.png", "rerun.png")
_BLOCK = 20  # pixels


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


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        draw(Path(temporary))
        for name in PICTURES:
            (IMAGES / name).write_bytes((Path(temporary) / name).read_bytes())
