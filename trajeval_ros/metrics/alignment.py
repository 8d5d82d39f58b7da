"""Trajectory alignment: the element of the gauge that brings the estimate to the groundtruth.

Tutorial, section III-C. Many states: Alg. 1 (Umeyama), for yaw with the rotation of eq. (18);
one state: eq. (19) and (20).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.metrics.moments import Moments

# Below this ratio of squared lengths a direction is rounding, not motion.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Alignment:
    """A similarity with what the data say about it.

    Attributes:
        similarity: Maps the estimate onto the groundtruth.
        states_used: Number of states that it was computed from.
        undetermined: Empty, or the sentence that says why the rotation is not determined by
            the states; rotation errors under this alignment mean nothing then.

    Example:
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> evaluate(flight.groundtruth, flight.estimate).alignment.undetermined
        ''
    """

    similarity: Similarity
    states_used: int
    undetermined: str = ""


@dataclass(frozen=True, eq=False)
class AlignmentSolution:
    """The least-squares alignment of some moments, and how well they determine its rotation.

    The curvature of the cost about its flattest axis is a squared lever arm: positions that far
    to the side of the axis would resist a turn as much. They resist it in vain if the errors,
    a wrong scale left out, are larger.

    Attributes:
        gauge: What the alignment may change.
        similarity: The alignment.
        lever_m: The lever arm, metres; infinite where the gauge has no rotation.
        residual_m: Root mean square of the errors under the best scale, metres.
    """

    gauge: Gauge
    similarity: Similarity
    lever_m: float = np.inf
    residual_m: float = 0.0

    @property
    def rotation_uncertainty(self) -> float:
        """Turn that costs as much as the errors present, rad; infinite if none costs anything."""
        if self.lever_m == np.inf:
            return 0.0
        return self.residual_m / self.lever_m if self.lever_m > 0.0 else np.inf

    @property
    def undetermined(self) -> str:
        """Empty, or why the positions don't determine the rotation."""
        if self.rotation_uncertainty < 1.0:
            return ""
        about_gravity = self.gauge.turns_about_gravity_only
        axis = "gravity" if about_gravity else "the direction of travel"
        return (
            f"the positions don't determine the alignment's rotation about {axis}: they extend "
            f"{self.lever_m:.2g} m to its side, with residuals of {self.residual_m:.2g} m "
            "(a straight line, no motion, or an estimate unlike the groundtruth)"
        )


def solve(gauge: Gauge, moments: Moments) -> AlignmentSolution:
    """Return the least-squares alignment, eq. (13) in the gauge: Alg. 1, or with eq. (18)."""
    if not gauge.has_translation:
        return AlignmentSolution(gauge, Similarity.identity())
    sigma = moments.covariance_pq
    if gauge.turns_freely:
        # scipy's LAPACK takes a third of the time, but importing it as long as a whole evaluation.
        u, d, vt = np.linalg.svd(sigma)
        flip = -1.0 if _is_mirrored(u @ vt) else 1.0
        rotation = (u * [1.0, 1.0, flip]) @ vt
        curvature = float(d[1] + flip * d[2])  # of the cost about its flattest axis, m^2/rad^2
    elif gauge.turns_about_gravity_only:
        sine, cosine = sigma[1, 0] - sigma[0, 1], sigma[0, 0] + sigma[1, 1]
        rotation = lie.about_gravity(np.arctan2(sine, cosine))
        curvature = float(np.hypot(sine, cosine))
    else:
        return AlignmentSolution(gauge, _mean_to_mean(np.eye(3), 1.0, moments))
    # Line 9 of Alg. 1: trace(D W) is the trace of R^T Sigma.
    best_scale = 1.0
    if moments.variance_q > 0.0:
        best_scale = float(np.vdot(rotation, sigma)) / moments.variance_q
        # Groundtruth at rest has no scale: what is left is the rounding of the sums.
        if best_scale <= _ROUNDING * moments.anchor.scale:
            best_scale = 0.0
    lever_squared = best_scale * curvature
    if lever_squared <= _ROUNDING * best_scale**2 * moments.variance_q:
        lever_squared = 0.0
    return AlignmentSolution(
        gauge,
        _mean_to_mean(rotation, best_scale if gauge.has_scale else 1.0, moments),
        math.sqrt(lever_squared),
        moments.spread(best_scale * rotation),
    )


def _is_mirrored(orthogonal: Floats) -> bool:
    """Return whether an orthogonal matrix (3, 3) has the determinant -1."""
    (a, b, c), (d, e, f), (g, h, i) = orthogonal.tolist()
    return bool(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0.0)


def _mean_to_mean(rotation: Floats, scale: float, moments: Moments) -> Similarity:
    """Return the similarity of a rotation and scale with the translation of line 10 of Alg. 1."""
    return Similarity(rotation, moments.mean_difference(scale * rotation), scale)


def align(
    gauge: Gauge | str,
    groundtruth: Floats,
    estimate: Floats,
    weights: Floats | None = None,
) -> Alignment:
    """Align N estimated positions with the groundtruth's (Alg. 1, or with eq. 18), (N, 3) each.

    Args:
        gauge: What the alignment may change, or its name.
        groundtruth: (N, 3), metres. For `planar` the height plays no part in the rotation.
        estimate: (N, 3), metres.
        weights: (N,) positive, per pair, as in `weighted_alignment`; None for all alike.

    Raises:
        DegenerateGeometryError: Fewer states than the gauge needs, or no motion at all where a
            rotation is to be found.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import align
        >>> points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        >>> align("sim3", 2.0 * points + 5.0, points).similarity.scale.__round__(9)
        2.0
    """
    gauge = Gauge.of(gauge)
    count = len(groundtruth)
    if count < gauge.minimum_states:
        raise DegenerateGeometryError(
            f"gauge {gauge.value} needs at least {gauge.minimum_states} matched states to align, "
            f"there {'is' if count == 1 else 'are'} {count}; align the first state alone "
            "(align states 1), or choose a gauge that turns less"
        )
    moments = Moments.of_pairs(groundtruth, estimate, weights)
    if gauge.minimum_states > 1:
        _require_motion("groundtruth", groundtruth)
        _require_motion("estimate", estimate)
    solution = solve(gauge, moments)
    return Alignment(solution.similarity, count, solution.undetermined)


def _require_motion(who: str, positions: Floats) -> None:
    extent = max(float(np.ptp(positions[:, axis])) for axis in range(3))
    if extent <= _ROUNDING * max(1.0, float(np.abs(positions[0]).max())):
        raise DegenerateGeometryError(
            f"the {who} does not move in the {len(positions)} states to be aligned, so no "
            "rotation can be found; use more states, the first alone (align states 1), or "
            "gauge translation"
        )


def align_first(
    gauge: Gauge,
    groundtruth_position: Floats,
    groundtruth_quaternion: Floats | None,
    estimate_position: Floats,
    estimate_quaternion: Floats | None,
) -> Alignment:
    """Align by a single state: eq. (19), for yaw with the rotation of eq. (20).

    Raises:
        DegenerateGeometryError: Sim(3), since one state has no scale; a gauge with rotation
            where a rotation is not measured; a yaw that the two rotations leave open.
    """
    if gauge.has_scale:
        raise DegenerateGeometryError(
            "one state has no scale, so gauge sim3 can't be aligned by the first state alone "
            "(tutorial, Table I); use more states, or se3"
        )
    rotation = np.eye(3)
    if gauge.minimum_states > 1:
        if groundtruth_quaternion is None or estimate_quaternion is None:
            raise DegenerateGeometryError(
                f"gauge {gauge.value} can't be aligned by the first state alone without "
                "orientations on both sides; align by more states"
            )
        between = lie.multiply(groundtruth_quaternion, lie.conjugate(estimate_quaternion))
        if gauge.turns_freely:
            rotation = lie.to_matrix(lie.normalized(between))
        else:
            if np.hypot(between[2], between[3]) < 1e-9:
                raise DegenerateGeometryError(
                    "the first state's rotations differ by half a turn about a level axis, which "
                    "leaves the yaw open; are the up axes of both trajectories right (--up)?"
                )
            rotation = lie.about_gravity(float(lie.yaw(between)))
    translation = groundtruth_position - rotation @ estimate_position
    similarity = Similarity(rotation, translation if gauge.has_translation else np.zeros(3))
    return Alignment(similarity, 1)
