"""Images of the ground: grey values of ROS maps, where their corners are, and limits of sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from refusals import is_refused

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io import ground_image
from trajeval_ros.io.ground_image import parse_bounds, read_ground_image

Image = pytest.importorskip("PIL.Image", reason="Pillow is missing")
# Occupancies of 0, 0.1960..., 0.65 and 1 are these values, of 255.
GREY = np.array([[255, 206, 205, 204], [90, 89, 88, 0]], dtype=np.uint8)


def ros_map(folder: Path, text: str = "", pixels: Any = GREY, origin: str = "[0, 0, 0]") -> Path:
    Image.fromarray(pixels).save(folder / "map.png")
    path = folder / "map.yaml"
    path.write_text(f"image: map.png\nresolution: 0.5\norigin: {origin}\n{text}")
    return path


@pytest.mark.parametrize(
    ("text", "pixels"),
    [
        ("", [[254, 254, 205, 205], [205, 0, 0, 0]]),
        ("mode: trinary", [[254, 254, 205, 205], [205, 0, 0, 0]]),
        ("mode: scale", GREY),
        ("negate: 1\nmode: raw", 255 - GREY),
        ("negate: 0\nmode: raw", GREY),
        ("negate: 1", [[0, 0, 0, 0], [205, 205, 205, 254]]),
        ("free_thresh: 0.2", [[254, 254, 254, 205], [205, 0, 0, 0]]),
        ("free_thresh: 0.1922", [[254, 254, 205, 205], [205, 0, 0, 0]]),
        ("free_thresh: 0.1921", [[254, 205, 205, 205], [205, 0, 0, 0]]),
        ("occupied_thresh: 0.66", [[254, 254, 205, 205], [205, 205, 205, 0]]),
        ("occupied_thresh: 0.653", [[254, 254, 205, 205], [205, 205, 0, 0]]),
    ],
)
def test_cells_are_free_occupied_or_unknown_by_the_thresholds(
    tmp_path: Path, text: str, pixels: Any
) -> None:
    np.testing.assert_array_equal(read_ground_image(ros_map(tmp_path, text)).pixels, pixels)


def test_a_map_in_colours_becomes_grey(tmp_path: Path) -> None:
    colours = np.zeros((2, 3, 3), dtype=np.uint8)
    colours[1, 2] = 30, 60, 120
    found = read_ground_image(ros_map(tmp_path, "mode: raw", colours))
    np.testing.assert_array_equal(found.pixels, [[0, 0, 0], [0, 0, 70]])


def test_a_map_is_turned_about_its_origin(tmp_path: Path) -> None:
    path = ros_map(tmp_path, origin="[10.0, -4.0, 0.5]")
    found = read_ground_image(path).to_world
    for corner, (along, up) in (
        ((0.0, 2.0), (0.0, 0.0)),
        ((4.0, 2.0), (2.0, 0.0)),
        ((0.0, 0.0), (0.0, 1.0)),
        ((4.0, 0.0), (2.0, 1.0)),
    ):
        cos, sin = np.cos(0.5), np.sin(0.5)
        expected = [10.0 + cos * along - sin * up, -4.0 + sin * along + cos * up]
        np.testing.assert_allclose(found @ [*corner, 1.0], expected, atol=1e-12)
    with pytest.raises(SettingsError, match="already has a position"):
        read_ground_image(path, (0.0, 0.0, 1.0, 1.0))


def test_a_map_that_is_drawn_smaller_has_the_same_corners(tmp_path: Path) -> None:
    pixels = np.zeros((40, 60), dtype=np.uint8)
    path = ros_map(tmp_path, "mode: raw", pixels, "[1.0, 2.0, 0.0]")
    with mock.patch.object(ground_image, "_MOST_DRAWN", 600):
        found = read_ground_image(path)
    assert found.pixels.shape == (20, 30)
    np.testing.assert_allclose(found.to_world @ [0.0, 20.0, 1.0], [1.0, 2.0])
    np.testing.assert_allclose(found.to_world @ [30.0, 0.0, 1.0], [31.0, 22.0])
    for most, shape in ((2400, (40, 60)), (2399, (40, 60)), (1, (1, 1)), (100, (8, 12))):
        with mock.patch.object(ground_image, "_MOST_DRAWN", most):
            assert read_ground_image(path).pixels.shape == shape


def test_an_image_may_have_so_many_pixels(tmp_path: Path) -> None:
    assert (ground_image._MOST_PIXELS, ground_image._MOST_DRAWN) == (60_000_000, 4_000_000)
    path = ros_map(tmp_path)
    for most in (8, 7):
        with mock.patch.object(ground_image, "_MOST_PIXELS", most):
            assert is_refused(read_ground_image, path) == (most == 7)


@pytest.mark.parametrize(
    ("mode", "shape"),
    [("1", (4, 6)), ("L", (4, 6)), ("LA", (4, 6)), ("I;16", (4, 6)), ("RGB", (4, 6, 3)),
     ("P", (4, 6, 3)), ("RGBA", (4, 6, 3))],
)  # fmt: skip
def test_images_are_grey_or_coloured(tmp_path: Path, mode: str, shape: tuple[int, ...]) -> None:
    path = tmp_path / "x.png"
    Image.new(mode, (6, 4)).save(path)
    found = read_ground_image(path, (1.0, 2.0, 7.0, 10.0))
    assert found.pixels.shape == shape
    assert found.pixels.dtype == np.uint8
    np.testing.assert_array_equal(found.to_world, [[1.0, 0.0, 1.0], [0.0, -2.0, 10.0]])


@pytest.mark.parametrize(
    ("image", "world", "is_found"),
    [
        ("a.png", "a.pgw", True),
        ("a.png", "a.pngw", True),
        ("a.png", "a.wld", True),
        ("a.jpeg", "a.jgw", True),
        ("a.png", "a.jgw", False),
        ("a.png", "b.pgw", False),
    ],
)
def test_a_world_file_is_next_to_its_image(
    tmp_path: Path, image: str, world: str, *, is_found: bool
) -> None:
    Image.new("L", (6, 4)).save(tmp_path / image)
    (tmp_path / world).write_text("0.5\n0.1\n0.2\n-0.25\n10\n20\n")
    if not is_found:
        assert is_refused(read_ground_image, tmp_path / image)
        return
    found = read_ground_image(tmp_path / image).to_world
    # The centre of the first pixel, and steps to the right and down.
    np.testing.assert_allclose(found @ [0.5, 0.5, 1.0], [10.0, 20.0])
    np.testing.assert_allclose(found[:, :2], [[0.5, 0.2], [0.1, -0.25]])


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("1 0 0 -1 0 0", False),
        ("1 2 2 4 0 0", True),  # no area
        ("1 2 2 4.1 0 0", False),
        ("1 0 0 -1 0", True),
        ("1 0 0 -1 0 0 0", True),
        ("1 0 0 -1 nan 0", True),
        ("1 0 0 x 0 0", True),
    ],
)
def test_a_world_file_has_six_numbers(tmp_path: Path, text: str, *, refused: bool) -> None:
    Image.new("L", (6, 4)).save(tmp_path / "a.png")
    path = tmp_path / "a.pgw"
    path.write_text(text)
    assert is_refused(read_ground_image, tmp_path / "a.png") == refused
    if not refused:
        path.write_text(text.ljust(10_000))
        assert not is_refused(read_ground_image, tmp_path / "a.png")
        path.write_text(text.ljust(10_001))
        assert is_refused(read_ground_image, tmp_path / "a.png")


@pytest.mark.parametrize(
    ("text", "bounds"),
    [
        ("0,1,2,3", (0.0, 1.0, 2.0, 3.0)),
        ("-2, -1, -1.5, 0", (-2.0, -1.0, -1.5, 0.0)),
        ("0,1,0,3", None),
        ("0,1,2,1", None),
        ("2,1,0,3", None),
        ("0,3,2,1", None),
        ("0,1,2", None),
        ("0,1,2,3,4", None),
        ("0,1,inf,3", None),
        ("-inf,1,2,3", None),
        ("0,-inf,2,3", None),
        ("0,1,2,inf", None),
        ("a", None),
    ],
)
def test_bounds_are_lower_left_and_upper_right(text: str, bounds: Any) -> None:
    if bounds is None:
        assert is_refused(parse_bounds, text)
    else:
        assert parse_bounds(text) == bounds


@pytest.mark.parametrize(
    "text", ["resolution: -0.5", "resolution: 0", "resolution: true", "origin: [1, 2, 1.1e12]",
             "free_thresh: x", "occupied_thresh: [1]", "image: ''", "origin: [1, 2, 3, 4]"]
)  # fmt: skip
def test_wrong_fields_of_a_map_are_refused(tmp_path: Path, text: str) -> None:
    path, (name, _, value) = ros_map(tmp_path), text.partition(": ")
    lines = [each for each in path.read_text().splitlines() if not each.startswith(name)]
    path.write_text("\n".join([*lines, f"{name}: {value}"]))
    with pytest.raises(InputError, match=name.split("_")[0]):
        read_ground_image(path)
