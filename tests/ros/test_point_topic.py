"""Points of PointCloud2 messages, of any layout."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ros_bags import STORE

from trajeval_ros.ros.point_topic import MOST_POINTS, points_of

FLOAT32, FLOAT64, UINT16 = 7, 8, 4


def cloud(
    points: np.ndarray,
    kind: int = FLOAT32,
    *,
    order: str = "<",
    height: int = 1,
    before: int = 0,
    padding: int = 0,
    names: str = "xyz",
) -> Any:
    """Return a cloud with bytes before the coordinates of a point, and after a row."""
    size = {FLOAT32: 4, FLOAT64: 8, UINT16: 2}[kind]
    step, width = before + 3 * size, len(points) // height
    letters = {FLOAT32: "f4", FLOAT64: "f8", UINT16: "u2"}
    values = points.astype(order + letters[kind]).view(np.uint8).reshape(height, width, 3 * size)
    data = np.zeros((height, width * step + padding), np.uint8)
    rows = data[:, : width * step].reshape(height, width, step)
    rows[..., before:] = values
    data[:, : width * step] = rows.reshape(height, -1)
    types = STORE.types
    field = types["sensor_msgs/msg/PointField"]
    fields = [field(name, before + size * at, kind, 1) for at, name in enumerate(names)]
    time = types["builtin_interfaces/msg/Time"](1, 0)
    header = types["std_msgs/msg/Header"](time, "lidar")
    return types["sensor_msgs/msg/PointCloud2"](
        header, height, width, fields, order == ">", step, data.shape[1], data.ravel(), True
    )


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("kind", [FLOAT32, FLOAT64])
@pytest.mark.parametrize("layout", [{}, {"before": 5}, {"height": 4, "padding": 7, "before": 2}])
def test_coordinates_of_any_layout(order: str, kind: int, layout: dict[str, int]) -> None:
    points = np.random.default_rng(0).normal(size=(120, 3)).astype(np.float32)
    result = points_of(cloud(points, kind, order=order, **layout))
    assert result is not None
    assert (result == points).all()


@pytest.mark.parametrize("count", [0, 1, MOST_POINTS, MOST_POINTS + 1, 10_080])
def test_large_clouds_are_thinned_evenly(count: int) -> None:
    points = np.arange(3.0 * count).reshape(-1, 3)
    result = points_of(cloud(points, FLOAT64))
    assert result is not None
    assert len(result) == min(count, MOST_POINTS)
    steps = np.diff(result[:, 0] / 3.0)
    most = -(-count // MOST_POINTS)
    assert ((steps >= 1) & (steps <= most)).all()
    if count:
        assert (result[[0, -1]] == points[[0, -1]]).all()


def test_points_without_return_are_left_out() -> None:
    points = np.ones((4, 3))
    points[1, 2], points[2, 0] = np.nan, np.inf
    result = points_of(cloud(points))
    assert result is not None
    assert len(result) == 2


@pytest.mark.parametrize(
    "broken",
    [
        {"names": "xyi"},
        {"kind": UINT16},
    ],
)
def test_clouds_without_coordinates_are_refused(broken: dict[str, Any]) -> None:
    assert points_of(cloud(np.ones((4, 3)), **broken)) is None


@pytest.mark.parametrize(
    ("name", "value"),
    [("width", 5), ("width", 2**32 - 1), ("height", 2), ("point_step", 0), ("point_step", 5)],
)
def test_clouds_with_too_few_bytes_are_refused(name: str, value: int) -> None:
    message = cloud(np.ones((4, 3)))
    setattr(message, name, value)
    assert points_of(message) is None
