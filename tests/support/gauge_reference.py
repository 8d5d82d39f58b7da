"""The inputs of gauge.json as our objects."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.inertial import ImuNoise, Preintegrated, preintegrate
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.reprojection_errors import Camera
from trajeval_ros.papers.state import State


class Case:
    """Four keyframes and eight landmarks, linearised away from the minimum.

    Attributes:
        numbers: The whole file.
        preintegrated: Its three intervals.
        problem: Its measurements.
        reference_rotation: (3, 3) of eq. (9).
        state: The point of linearisation.
    """

    def __init__(self, numbers: dict[str, Any]) -> None:
        """Read the inputs."""
        self.numbers = numbers
        given = numbers["inputs"]
        column = {name: np.array(value) for name, value in given.items()}
        self.preintegrated: Preintegrated = preintegrate(
            column["omega"],
            column["acc"],
            given["imu_dt"],
            ImuNoise(given["sigma_g"], given["sigma_a"]),
        )
        self.problem = Problem(
            Camera(given["f"], round(2 * given["cx"]), round(2 * given["cy"]), given["sigma_px"]),
            column["R_BC"],
            column["uv"],
            column["obs_cam"],
            column["obs_lm"],
            given["K"],
            self.preintegrated,
        )
        estimate = {name: np.array(value) for name, value in given["est"].items()}
        self.reference_rotation = so3.exp(column["ref_rotvec0"])
        self.state = State.at(
            estimate["p"], so3.exp(estimate["rotvec"]), estimate["v"], estimate["X"]
        ).referred_to(self.reference_rotation, column["ref_p0"])

    def trajectory(self, side: str) -> Trajectory:
        """Return the keyframes of `gt` or `est`."""
        column = {name: np.array(value) for name, value in self.numbers["inputs"][side].items()}
        return Trajectory(
            np.arange(len(column["p"]), dtype=np.int64) * 10**9,
            column["p"],
            Rotation.from_rotvec(column["rotvec"]).as_quat(),
            column["v"],
        )
