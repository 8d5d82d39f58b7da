"""Images of the ground below plotted paths: ROS maps, and images with a world file or bounds.

The files are untrusted input. YAML is loaded safely. Images have a size limit and one of a few
formats that contain only pixels.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.io.yaml_file import read_mapping

_MOST_PIXELS = 60_000_000
_MOST_DRAWN = 4_000_000  # pixels; more are not visible in print
_FORMATS = ("PNG", "PPM", "JPEG", "TIFF", "BMP")
_WORLD_FILE_BYTES = 10_000
_UNKNOWN = 205  # grey value that ROS's map_saver writes for unknown cells


@dataclass(frozen=True, eq=False)
class GroundImage:
    """An image in the xy plane of the fixed frame."""

    # (H, W) grey or (H, W, 3) colour values, 0 to 255, the top row first.
    pixels: NDArray[np.uint8]
    # (2, 3), maps (u, v, 1) to x and y, metres. The upper left corner of the image is u = v = 0,
    # the lower right corner u = W, v = H.
    to_world: Floats


def parse_bounds(text: str) -> tuple[float, float, float, float]:
    """Return the bounds in a text "x0,y0,x1,y1": lower left and upper right corner, metres."""
    try:
        x0, y0, x1, y1 = (float(each) for each in text.split(","))
    except ValueError:
        x0 = y0 = x1 = y1 = math.nan
    if not (x0 < x1 and y0 < y1 and all(map(math.isfinite, (x0, y0, x1, y1)))):
        raise SettingsError(
            f"the bounds {text!r} are not valid; give the lower left and the upper right corner "
            "in metres, as in 0,0,120,80"
        )
    return x0, y0, x1, y1


def read_ground_image(
    path: Path, bounds: tuple[float, float, float, float] | None = None
) -> GroundImage:
    """Read a ROS map (its YAML file), or an image.

    `bounds`: left, lower, right and upper edge of an image, metres. None to read the world file
    next to the image: `.pgw` for `.png`, or `.wld`.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        if bounds is not None:
            raise SettingsError(f"{path} already has a position; give bounds for images only")
        return _ros_map(path)
    if bounds is not None:
        pixels, _ = _read_image(path)
        height, width = pixels.shape[:2]
        left, lower, right, upper = bounds
        across, down = (right - left) / width, (lower - upper) / height
        return GroundImage(pixels, np.array([[across, 0.0, left], [0.0, down, upper]]))
    to_world = _world_file(path)
    pixels, shrunk = _read_image(path)
    return GroundImage(pixels, to_world @ shrunk)


def _ros_map(path: Path) -> GroundImage:
    said = read_mapping(path, "ROS map")
    image = said.get("image")
    if not isinstance(image, str) or not image:
        raise InputError(f"{path} is not a ROS map: it has no field image")
    resolution = _number(path, said, "resolution")
    origin = said.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise InputError(f"the origin in {path} must be three numbers: x, y and yaw")
    x, y, yaw = (_number(path, {"origin": each}, "origin") for each in origin)
    if not resolution > 0.0:
        raise InputError(f"the resolution in {path} must be greater than 0 m, not {resolution:g}")
    grey, shrunk = _read_image(path.parent / image)
    if grey.ndim == 3:
        grey = grey.mean(axis=2).astype(np.uint8)
    if said.get("negate"):
        grey = 255 - grey
    if said.get("mode", "trinary") == "trinary":
        occupied = (255.0 - grey) / 255.0
        free = occupied < _number(path, {"free_thresh": 0.196, **said}, "free_thresh")
        full = occupied > _number(path, {"occupied_thresh": 0.65, **said}, "occupied_thresh")
        grey = np.where(full, 0, np.where(free, 254, _UNKNOWN)).astype(np.uint8)
    cos, sin = math.cos(yaw), math.sin(yaw)
    turned = np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]])
    rows = grey.shape[0] * shrunk[1, 1]  # of the file
    upright = np.array(
        [[resolution, 0.0, 0.0], [0.0, -resolution, resolution * rows], [0.0, 0.0, 1.0]]
    )
    return GroundImage(grey, (turned @ upright @ shrunk)[:2])


def _world_file(path: Path) -> Floats:
    """Return the transformation (2, 3) as in `GroundImage.to_world`.

    A world file has the position of the centre of the upper left pixel; `to_world` has its corner.
    """
    kind = path.suffix.removeprefix(".")
    names = [f".{kind[0]}{kind[-1]}w", f".{kind}w", ".wld"] if kind else [".wld"]
    beside = [path.with_suffix(each) for each in names]
    found = next((each for each in beside if each.is_file()), None)
    if found is None:
        raise InputError(
            f"the position of {path} is unknown; give --map-bounds, or add a world file such as "
            f"{beside[0].name}"
        )
    try:
        if found.stat().st_size > _WORLD_FILE_BYTES:
            raise ValueError("it is too large")
        values = [float(line) for line in found.read_text(encoding="ascii").split()]
        a, d, b, e, c, f = values
        if not all(map(math.isfinite, values)) or a * e == b * d:
            raise ValueError("its pixels have no area")
    except (OSError, ValueError) as error:
        raise InputError(f"{found} is not a world file of six numbers: {error}") from error
    return np.array([[a, b, c - 0.5 * (a + b)], [d, e, f - 0.5 * (d + e)]])


def _read_image(path: Path) -> tuple[NDArray[np.uint8], Floats]:
    """Return the pixels, reduced if there are too many, and the scaling (3, 3).

    The scaling maps (u, v, 1) of the returned pixels to (u, v, 1) of the pixels in the file.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise InputError(f"images need Pillow; install it: {extra_command('plot')}") from error
    try:
        if not path.is_file():
            raise InputError(f"{path} is not a file")
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=_FORMATS) as image:
                width, height = image.size
                if width * height > _MOST_PIXELS:
                    raise InputError(
                        f"{path} has {width} x {height} pixels, the limit is {_MOST_PIXELS}; "
                        "reduce the resolution"
                    )
                has_colours = image.mode not in ("1", "L", "LA", "I", "I;16", "F")
                drawn = image.convert("RGB" if has_colours else "L")
                factor = math.sqrt(max(1.0, width * height / _MOST_DRAWN))
                if factor > 1.0:
                    size = max(1, round(width / factor)), max(1, round(height / factor))
                    drawn = drawn.resize(size, Image.Resampling.BOX)
                pixels = np.asarray(drawn)
    except (
        OSError, ValueError, SyntaxError, Image.DecompressionBombError,
        Image.DecompressionBombWarning,
    ) as error:  # fmt: skip
        raise InputError(f"the image {path} can't be read: {error}") from error
    return pixels, np.diag([width / pixels.shape[1], height / pixels.shape[0], 1.0])


def _number(path: Path, said: dict[str, Any], name: str) -> float:
    value: Any = said.get(name)
    if type(value) not in (int, float) or not abs(value) <= LARGEST:
        raise InputError(f"the {name} in {path} must be a number, not {value!r}")
    return float(value)
