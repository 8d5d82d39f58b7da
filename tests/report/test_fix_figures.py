"""Figures of GNSS fixes: where they are, what they claim, and of what status they are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fix_runs import fixes_of, quality

from trajeval_ros import Protocol, evaluate, simulate
from trajeval_ros.metrics.evaluation import Evaluation

pytest.importorskip("matplotlib", reason="matplotlib is missing")

from matplotlib.collections import EllipseCollection

from trajeval_ros.report.figures import draw

FLIGHT = simulate(seed=8, duration_s=40.0)
SIGMA_M, FLOAT_M = 0.5, 2.0


def evaluation() -> Evaluation:
    """Return an evaluation by fixes, ten of which are not augmented, and three unknown."""
    truth = FLIGHT.groundtruth[::80]
    rows = quality(len(truth), sigma_m=SIGMA_M)
    rows[10:20, 0], rows[10:20, 2:] = 0, quality(10, sigma_m=FLOAT_M)[:, 2:]
    rows[30:33, 1] = 0
    fixes = fixes_of(truth.stamps, truth.positions, rows)
    return evaluate(fixes, FLIGHT.estimate, Protocol(gauge="yaw"))


def test_fixes_are_coloured_by_status_within_their_ellipses() -> None:
    result = evaluation()
    [axes] = draw(result, "top").axes
    lines = [line for line in axes.get_lines() if "fixes" in str(line.get_label())]
    assert len({line.get_color() for line in lines}) == 2
    count = len(result.groundtruth)
    assert {str(line.get_label()): len(np.asarray(line.get_xdata())) for line in lines} == {
        "fixes of status 0 (GNSS alone), 95 %": 10,
        "fixes of status 2 (ground-based), 95 %": count - 10,
    }
    ellipses = [
        collection for collection in axes.collections if isinstance(collection, EllipseCollection)
    ]
    assert [len(ellipse.get_widths()) for ellipse in ellipses] == [10, count - 13]
    # 95 % of two dimensions lie within sqrt(-2 ln 0.05) sigma.
    scale = 2.0 * np.sqrt(-2.0 * np.log(0.05))
    for ellipse, sigma_m in zip(ellipses, (FLOAT_M, SIGMA_M), strict=True):
        np.testing.assert_allclose(ellipse.get_widths(), scale * sigma_m, rtol=1e-6)
        np.testing.assert_allclose(ellipse.get_heights(), scale * sigma_m, rtol=1e-6)


def test_heights_are_claimed_to_be_twice_as_bad() -> None:
    [axes] = draw(evaluation(), "side").axes
    ellipses = [
        collection for collection in axes.collections if isinstance(collection, EllipseCollection)
    ]
    assert len(ellipses) > 0
    for ellipse in ellipses:
        np.testing.assert_allclose(
            ellipse.get_widths(), 2.0 * np.asarray(ellipse.get_heights()), 1e-6
        )
        np.testing.assert_allclose(np.abs(ellipse.get_angles()), 90.0, atol=1e-3)


def test_other_groundtruth_has_none() -> None:
    result = evaluate(FLIGHT.groundtruth, FLIGHT.estimate, Protocol(gauge="yaw"))
    assert not any("fixes" in str(line.get_label()) for line in draw(result, "top").axes[0].lines)
    points = dataclasses.replace(FLIGHT.groundtruth[::80], quaternions=None)
    result = evaluate(points, FLIGHT.estimate, Protocol(gauge="yaw"))
    assert not any("fixes" in str(line.get_label()) for line in draw(result, "top").axes[0].lines)
