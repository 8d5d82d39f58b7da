"""Ranges of the plots of a picture."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.viewer import scene_entities
from trajeval_ros.viewer.blueprint import blueprint

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")


def views(part: Any) -> Iterator[Any]:
    for item in getattr(part, "contents", ()):
        if hasattr(item, "class_identifier"):
            yield item
        else:
            yield from views(item)


def range_of_rotations(rotations_deg: Floats) -> list[float] | None:
    estimate = scene_entities.EstimateEntities("vio", 0)
    layout = blueprint([estimate], Gauge.YAW, is_live=True, rotations_deg=rotations_deg)
    [plot] = [view for view in views(layout.root_container) if "Rotation error" in view.name]
    axis = plot.properties.get("ScalarAxis")
    return None if axis is None else axis.range.as_arrow_array().to_pylist()[0]


def test_the_first_second_does_not_flatten_the_plot_of_rotation_errors() -> None:
    settled = np.linspace(0.1, 0.2, 990)
    assert range_of_rotations(settled) is None
    low, high = range_of_rotations(np.concatenate([np.full(10, 60.0), settled])) or (1.0, 0.0)
    assert low == 0.0
    assert 0.2 < high < 0.3


def test_an_axis_has_a_label_besides_0() -> None:
    """Rerun labels 1 and 10, and not the metres between them where these are close."""
    assert range_of_rotations(np.linspace(0.0, 3.9, 100)) is None
    for largest, end in ((4.1, 10.4), (9.99, 10.4), (0.05, 0.104)):
        result = range_of_rotations(np.linspace(0.0, largest, 100))
        assert result == pytest.approx([0.0, end])
    assert range_of_rotations(np.zeros(3)) is None
