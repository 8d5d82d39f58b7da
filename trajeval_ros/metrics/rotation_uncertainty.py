"""Uncertainty of the alignment's rotation, and its comparison with the orientations.

A nearly straight path hardly determines the rotation about itself. Drift then decides the rotation
of the whole estimate, and the rotation error contains it. All results follow from sums over pairs,
so that a live run has them at a constant cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.metrics.moments import Moments, OrientationSum

UNDETERMINED_DEG = 30.0
# A rotation error is misleading if it exceeds both this multiple of the error of the alignment by
# orientations, and this angle.
_TIMES = 3.8
_LEAST_DEG = 2.0
# A constant rotation larger than this is not reported as an error.
_LARGE_TURN_DEG = 10.0
# Beyond this number of standard deviations, drift does not explain the rotation. The least
# standard deviation, rad, of a well determined axis: attitude can drift by this much on its own.
_DRIFT = 5.0
_LEAST_SPREAD = math.radians(_LEAST_DEG) / _DRIFT
# Ratio of squared lengths below which a component is rounding error rather than motion.
_ROUNDING = 1e-12
_IDENTITY = np.eye(3)


@dataclass(frozen=True)
class OrientationEvidence:
    """Comparison of the alignment with an alignment by orientations."""

    error_deg: float  # rotation error under the alignment (`OrientationSum.error`)
    least_deg: float  # rotation error under the alignment by orientations
    turn_deg: float  # angle between the two alignments
    # That angle in standard deviations of drift in positions and orientations; an undetermined
    # axis contributes 0.
    turn_in_stds: float


@dataclass(frozen=True)
class RotationUncertainty:
    """Uncertainty of an alignment's rotation."""

    rot_z: bool  # whether the gauge's rotation is about gravity only
    std_deg: float  # standard deviation about the least determined axis; infinite if undetermined
    # Comparison with the orientations; None without them on both sides.
    orientations: OrientationEvidence | None
    # Whether the rotation is undetermined and moves aligned positions: the groundtruth is on an
    # exact line, and the estimate leaves it.
    moves_positions: bool = False

    @property
    def is_misleading(self) -> bool:
        """Whether the rotation error is mostly one constant rotation of the alignment."""
        seen = self.orientations
        return (
            seen is not None
            and seen.error_deg >= _LEAST_DEG
            and seen.error_deg >= _TIMES * seen.least_deg
        )

    @property
    def disagrees(self) -> bool:
        """Whether drift does not explain that rotation: another body, or other axes."""
        seen = self.orientations
        return self.is_misleading and seen is not None and seen.turn_in_stds > _DRIFT

    @property
    def undetermined(self) -> str:
        """The reason why the rotation is undetermined; empty if it is determined."""
        if self.std_deg <= UNDETERMINED_DEG:
            return ""
        how = f"its standard deviation is {self.std_deg:.0f} deg"
        if self.std_deg == math.inf:
            how = "the positions do not constrain it"
        sentence = (
            f"the positions do not determine the alignment's rotation about {self._axis}: {how} "
            "(straight path, no motion, or unrelated trajectories)"
        )
        seen = self.orientations
        if seen is None:
            return sentence
        return (
            f"{sentence}; an alignment by orientations differs by {seen.turn_deg:.3g} deg and "
            f"has a rotation error of {seen.least_deg:.2g} deg"
        )

    @property
    def misleading(self) -> str:
        """The sentence about a rotation error that is mostly constant; empty if it is not."""
        seen = self.orientations
        if seen is None or not self.is_misleading:
            return ""
        alone = f"aligned by orientations, the rotation error is {seen.least_deg:.2g} deg"
        if self.disagrees:
            return (
                "positions and orientations disagree by a constant rotation of "
                f"{seen.turn_deg:.3g} deg (more than {_DRIFT:.0f} standard deviations); {alone}"
            )
        return (
            f"of the rotation error of {seen.error_deg:.3g} deg, {seen.turn_deg:.3g} deg are a "
            "constant rotation of the alignment, which positions determine poorly (standard "
            f"deviation {self.std_deg:.2g} deg about {self._axis}); {alone}"
        )

    @property
    def other_body(self) -> str:
        """The reason why the orientations are of another body or axes; empty if they are not."""
        seen = self.orientations
        is_large = seen is not None and seen.turn_deg >= _LARGE_TURN_DEG
        return self.misleading if is_large and self.disagrees else ""

    @property
    def why_withheld(self) -> str:
        """The reason why rotation errors are withheld; empty if they are reported."""
        seen = self.orientations
        if self.undetermined or seen is None or seen.turn_deg < _LARGE_TURN_DEG:
            return self.undetermined
        return self.misleading

    @property
    def _axis(self) -> str:
        return "gravity" if self.rot_z else "the direction of travel"


def rotation_uncertainty(
    gauge: Gauge,
    moments: Moments,
    orientations: OrientationSum | None,
    similarity: Similarity,
    by_orientations: Floats | None,
    arm_m: float,
    best_scale: float,
    *,
    is_free: bool,
) -> RotationUncertainty:
    """Return the uncertainty of an alignment's rotation.

    The covariance is the sandwich H^-1 G H^-1 of the alignment's cost. Let a be the aligned
    estimate's positions and e the errors, both about their means. H = tr(C_aa) I - C_aa is the
    curvature of the cost. G = E[(a x e) (a x e)^T] holds for errors that do not depend on the
    position, except through a wrong scale. Drift is correlated over the whole run, so that all
    pairs together count as one sample.

    `by_orientations` (3, 3) is the rotation of the gauge that fits the orientations best.
    Orientations have the weight `arm_m` in the alignment (see `alignment.solve`). `best_scale` is
    that of the alignment's rotation, for any gauge. `is_free`: the cost is constant, up to
    rounding, along some rotation.
    """
    rotation, linear = similarity.rotation, similarity.linear
    error = 0.0 if orientations is None else orientations.error(rotation)
    axes = slice(2, 3) if gauge.yaw_only else slice(0, 3)
    aligned = moments.covariance_aligned(linear)
    size = float(aligned.trace())
    curvature = ((size + arm_m**2) * _IDENTITY - aligned)[axes, axes]
    curvatures, directions = np.linalg.eigh(curvature)
    variances, principal = np.array([np.inf]), np.zeros((len(curvature), 1))
    is_off_line = bool(curvatures[0] > _ROUNDING * size)
    if not is_free and is_off_line:
        # The error of a wrong scale is parallel to the lever arm and causes no rotation.
        gradient = _of_cross_products(aligned, moments.covariance_error(best_scale * rotation))
        # Errors of orientations, weighted by the arm, count as one sample, too.
        gradient += arm_m**4 * error**2 / 3.0 * _IDENTITY
        inverse = directions / curvatures @ directions.T
        variances, principal = np.linalg.eigh(inverse @ gradient[axes, axes] @ inverse)
    seen = None
    if orientations is not None and by_orientations is not None:
        turn = lie.rotation_vector(lie.from_matrix(by_orientations @ rotation.T))
        least = orientations.error(by_orientations)
        spread = np.maximum(variances, 0.0) + least**2 / 3.0 + _LEAST_SPREAD**2
        seen = OrientationEvidence(
            error_deg=math.degrees(error),
            least_deg=math.degrees(least),
            turn_deg=math.degrees(math.hypot(*turn.tolist())),
            turn_in_stds=math.sqrt(float(np.square(turn[axes] @ principal) @ (1.0 / spread))),
        )
    std_deg = math.degrees(math.sqrt(max(float(variances[-1]), 0.0)))
    return RotationUncertainty(
        gauge.yaw_only,
        std_deg,
        seen,
        moves_positions=is_free and bool(is_off_line),
    )


def _of_cross_products(a: Floats, e: Floats) -> Floats:
    """Return E[(a x e)(a x e)^T] for independent vectors with covariances A and E, (3, 3) each."""
    trace_a, trace_e, product = float(a.trace()), float(e.trace()), a @ e
    crossed: Floats = product + product.T - trace_a * e - trace_e * a
    return crossed + (trace_a * trace_e - float(product.trace())) * _IDENTITY
