"""Gauge planar projects the states before it pairs them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from strategies import make_estimate, make_groundtruth

from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import evaluate, on_plane
from trajeval_ros.metrics.protocol import Protocol


@pytest.mark.parametrize("method", ["linear", "groundtruth-stamps"])
def test_planar_errors_are_those_of_projected_trajectories(method: str) -> None:
    truth = make_groundtruth(5, 300)
    estimate = make_estimate(truth, 6)
    estimate = dataclasses.replace(estimate, stamps=estimate.stamps + 3_000_000)
    protocol = Protocol(gauge="planar", association=AssociationRule(method=method), lengths=())
    result = evaluate(truth, estimate, protocol).absolute
    projected = evaluate(on_plane(truth), on_plane(estimate), protocol).absolute
    np.testing.assert_allclose(result.position_m, projected.position_m, rtol=1e-12)
    assert result.yaw_deg is not None
    assert projected.yaw_deg is not None
    np.testing.assert_allclose(result.yaw_deg, projected.yaw_deg, atol=1e-9)
