"""The origin of a live picture, which is told where it is not zero."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")

from trajeval_ros.viewer.live_pictures import GroundtruthPicture

SECOND = 10**9


def picture() -> tuple[GroundtruthPicture, list[Any]]:
    """Return a picture, and the events that it tells."""
    told: list[Any] = []
    recording: Any = SimpleNamespace(
        begin=None,
        log=lambda *_: None,
        send=lambda *_: None,
        event=lambda stamp, words, *, warn: told.append((stamp, words, warn)),
    )
    return GroundtruthPicture(recording), told


def states(place: tuple[float, float, float]) -> np.ndarray:
    rows = np.zeros((3, 10))
    rows[:, :3] = np.add(place, np.outer([0.0, 1.0, 2.0], [0.6, 0.0, 0.8]))
    rows[:, 6] = 1.0
    return rows


def test_an_origin_far_away_is_told_and_one_nearby_is_zero() -> None:
    drawn, told = picture()
    drawn.begin(5 * SECOND, states((1.0, 2.0, 3.0)))
    assert drawn.origin is not None
    assert not drawn.origin.any()
    assert told == []
    drawn, told = picture()
    assert drawn.size_m == 1.0
    far = states((465_000.0, 5_249_000.0, 400.0))
    drawn.begin(5 * SECOND, far)
    assert drawn.origin is not None
    [(stamp, words, warn)] = told
    assert stamp == 5 * SECOND
    numbers = ", ".join(f"{item:.0f}" for item in drawn.origin)
    assert words == f"origin of the drawing: ({numbers}) m"
    assert not warn
    drawn.add(np.arange(5, 8) * SECOND, far)
    np.testing.assert_allclose(drawn.corners, far[[0, 2], :3] - drawn.origin)
    assert np.abs(drawn.corners).max() < 1000.0
    drawn.draw_origin()
    assert told == [(stamp, words, warn)] * 2
