"""A few knots of the groundtruth quality check, with an IMU and samples that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.groundtruth_quality.inertial_steps import ImuSeconds, InertialSteps
from trajeval_ros.calibration.groundtruth_quality.joint_fit import Horizon, JointFit
from trajeval_ros.calibration.groundtruth_quality.rig import Rig
from trajeval_ros.calibration.groundtruth_quality.sample_rows import TruthSamples, rig_at
from trajeval_ros.geometry.inertial import ImuNoise

NOISE = ImuNoise(2e-3, 2e-2)


@dataclass(frozen=True, eq=False)
class Small:
    """Five knots, an IMU at 100 Hz and samples at 40 Hz that a rig nearly predicts."""

    samples: TruthSamples
    steps: InertialSteps
    rig: Rig

    def fit(self, **changed: object) -> JointFit:
        given = {"knot_s": 0.1, "noise": NOISE, "sigmas": (0.01, 0.02), **changed}
        return JointFit(
            self.samples, self.steps, self.rig, Horizon(**given), np.ones(10, dtype=bool)
        )


def small_rig() -> Small:
    """Return a rig whose samples have errors of one length, for which no weight is below 1."""
    generator = np.random.default_rng(5)
    seconds = np.arange(0.0, 0.6, 0.01)
    rates, forces = generator.normal(size=(2, len(seconds), 3)) + [[[0.4]], [[3.0]]]
    knots = np.linspace(0.105, 0.505, 5)
    steps = InertialSteps(knots, ImuSeconds(seconds, rates, forces))
    shape = (5, 3)
    rig = Rig(
        Rotation.from_rotvec(generator.normal(size=shape)).as_matrix(),
        generator.normal(size=shape),
        generator.normal(size=shape),
        np.tile(np.append(0.1 * generator.normal(size=3), np.zeros(3)), (5, 1)),
        Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix(),
        np.array([0.2, -0.3, 0.1]),
        0.02,
        1e-3,
        9.81 * np.array([0.1, -0.2, -0.9]) / np.linalg.norm([0.1, -0.2, -0.9]),
    )
    own = np.arange(0.1, 0.47, 0.025)
    blank = TruthSamples(
        own, np.zeros((len(own), 3)), np.tile([0.0, 0, 0, 1], (len(own), 1)), True
    )
    motions = steps.motions(rig.biases[:-1])
    states = rig_at(own + 0.02 + 1e-3 * (own - blank.middle_s), steps, motions, rig)
    # All errors have one length, for which no weight is below 1.
    errors = generator.normal(size=(2, len(own), 3))
    errors *= np.array([0.02, 0.03])[:, None, None] / np.linalg.norm(errors, axis=2)[..., None]
    marker = states.positions + states.rotations @ rig.lever
    rotated = Rotation.from_matrix(states.rotations @ rig.body) * Rotation.from_rotvec(errors[1])
    samples = TruthSamples(own, marker + errors[0], rotated.as_quat(), True)
    return Small(samples, steps, rig)
