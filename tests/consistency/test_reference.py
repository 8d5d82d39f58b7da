"""Covariances in five alignments' gauges against numbers of 50 digits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from consistency_runs import ALIGNMENTS, aligned_run, poses_of
from gauge_reference import Case
from visual_inertial_scenes import relative, to_left

from trajeval_ros.consistency.nees import diagonal_blocks, joint_nees, pose_nees
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.papers.gauge_trials import (
    fixed_covariance,
    free_covariance,
)

NAMES = dict(zip(ALIGNMENTS, ("first4", "yaw", "first6", "se3", "sim3"), strict=True))


@pytest.mark.parametrize("source", ["free", "fixed"])
@pytest.mark.parametrize(("gauge", "states"), ALIGNMENTS)
def test_errors_covariance_and_nees(
    reference: Callable[[str], Any], gauge: Gauge, states: int | None, source: str
) -> None:
    case = Case(reference("gauge"))
    expected = case.numbers["aligned"][NAMES[gauge, states]]
    make = free_covariance if source == "free" else fixed_covariance
    covariance = to_left(make(case.problem, case.state), case.state)
    truth, estimate = case.trajectory("gt"), case.trajectory("est")
    run = aligned_run(gauge, states, truth, estimate, covariance)
    assert run.similarity.scale == pytest.approx(expected["scale"], rel=1e-9)
    rotation = so3.log(run.similarity.rotation[None])[0]
    np.testing.assert_allclose(rotation, expected["rotvec"], atol=1e-9)
    assert relative(run.similarity.translation, np.array(expected["t"])) < 1e-9
    errors, joint = np.array(expected["error"]).reshape(-1, 9), np.array(expected["cov"])
    assert relative(run.errors, errors[:, :6]) < 1e-9
    assert relative(run.covariance, poses_of(joint)) < 1e-10
    assert run.transformation.dof == expected["rank"] - 3 * len(truth)
    # That number is of velocities, too, which no condition of an alignment is of. Its covariance
    # is given in double precision, of which an inverse keeps fewer digits.
    normals = np.pad(run.transformation.normals, ((0, 0), (0, 3), (0, 0)))
    assert joint_nees(errors, joint, normals) == pytest.approx(expected["nees_joint"], rel=1e-8)
    eigenvalues, vectors = np.linalg.eigh(poses_of(joint))
    seen = slice(-run.transformation.dof, None)
    along = errors[:, :6].ravel() @ vectors[:, seen]
    assert joint_nees(run.errors, run.covariance, run.transformation.normals) == pytest.approx(
        np.sum(along**2 / eigenvalues[seen]), rel=1e-6
    )
    first = 1 if states == 1 else 0
    single = pose_nees(run.errors[first:], diagonal_blocks(run.covariance, 6)[first:])
    np.testing.assert_allclose(single, expected["nees_pose6"][first:], rtol=1e-8)
