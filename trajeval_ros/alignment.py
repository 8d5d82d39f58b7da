"""Trajectory alignment: the element of the gauge that brings the estimate to the groundtruth.

Tutorial, section III-C. Many states: Alg. 1 (Umeyama), for yaw with the rotation of eq. (18);
one state: eq. (19) and (20). Everything that Alg. 1 needs are sums over pairs of positions, so
`Moments` hold them and one solver serves batches, sliding windows and shards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros import lie
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.gauge import Gauge
from trajeval_ros.trajectory import Trajectory

Array = NDArray[np.float64]

# Pairs to sum at once: what stays in a core's cache.
_BLOCK = 8192
# Below this ratio of squared lengths a direction is rounding, not motion.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * rotation x + translation; from the estimate's frame to the groundtruth's.

    Attributes:
        rotation: (3, 3) rotation matrix.
        translation: (3,), metres.
        scale: Positive factor, 1 for rigid transformations.
    """

    rotation: Array
    translation: Array
    scale: float = 1.0

    @classmethod
    def identity(cls) -> Similarity:
        """Return the transformation that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    def positions(self, points: Array) -> Array:
        """Return the points (N, 3) transformed."""
        moved: Array = points @ (self.scale * self.rotation).T + self.translation
        return moved

    def quaternions(self, quaternions: Array) -> Array:
        """Return the rotations, (N, 4) xyzw, turned: R_i -> R R_i."""
        turn = np.asarray(Rotation.from_matrix(self.rotation).as_quat())
        return lie.by_blocks(lambda rows: (lie.multiply(turn, rows),), quaternions)[0]

    def trajectory(self, trajectory: Trajectory) -> Trajectory:
        """Return the states transformed, eq. (14); biases are in the body and don't change."""
        quaternions, velocities = trajectory.quaternions, trajectory.velocities
        return replace(
            trajectory,
            positions=self.positions(trajectory.positions),
            rotations=None
            if quaternions is None
            else Rotation.from_quat(self.quaternions(quaternions)),
            velocities=None if velocities is None else self.vectors(velocities),
            covariances=None,
        )

    def vectors(self, vectors: Array) -> Array:
        """Return free vectors (N, 3), such as velocities, scaled and turned."""
        turned: Array = vectors @ (self.scale * self.rotation).T
        return turned

    @property
    def rotation_xyzw(self) -> Array:
        """The rotation as a quaternion with w >= 0, (4,)."""
        quaternion = np.asarray(Rotation.from_matrix(self.rotation).as_quat())
        return quaternion if quaternion[3] >= 0.0 else -quaternion


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over pairs (groundtruth position p, estimated position q) that alignment needs.

    Kept are the moments of (q, r), where r = p - (anchor of q) is the residual under an anchor
    alignment: sums of p and q themselves cancel when coordinates are large and errors small
    (3e-5 relative at 5 km; of residuals 3e-12). `+` merges, `-` removes; both operands must have
    the same anchor.

    Attributes:
        anchor: Alignment under which residuals are taken.
        weight: Sum of weights; the number of pairs where no weights were given.
        mean_q: (3,) mean estimated position, metres.
        mean_r: (3,) mean residual, metres.
        scatter_qq: (3, 3) sum of w (q - mean_q)(q - mean_q)^T.
        scatter_rq: (3, 3) sum of w (r - mean_r)(q - mean_q)^T.
        scatter_rr: Sum of w |r - mean_r|^2.
    """

    anchor: Similarity
    weight: float
    mean_q: Array
    mean_r: Array
    scatter_qq: Array
    scatter_rq: Array
    scatter_rr: float

    @classmethod
    def empty(cls, anchor: Similarity) -> Moments:
        """Return the moments of no pair at all."""
        return cls(anchor, 0.0, np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), 0.0)

    @classmethod
    def of_pairs(
        cls,
        groundtruth: Array,
        estimate: Array,
        weights: Array | None = None,
        anchor: Similarity | None = None,
    ) -> Moments:
        """Return the moments of N pairs of positions, (N, 3) each.

        Args:
            groundtruth: (N, 3) positions p, metres.
            estimate: (N, 3) positions q, metres.
            weights: (N,) positive weights; None weighs all pairs alike.
            anchor: Alignment for residuals; by default a shift of the first mean to the other.
        """
        if anchor is None and len(groundtruth):
            first = slice(_BLOCK)
            shift = groundtruth[first].mean(axis=0) - estimate[first].mean(axis=0)
            anchor = Similarity(np.eye(3), shift)
        anchor = anchor or Similarity.identity()
        moments = cls.empty(anchor)
        for begin in range(0, len(groundtruth), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            w = None if weights is None else weights[rows]
            moments += cls._of_block(groundtruth[rows], estimate[rows], w, anchor)
        return moments

    @classmethod
    def _of_block(
        cls, groundtruth: Array, estimate: Array, weights: Array | None, anchor: Similarity
    ) -> Moments:
        w = np.ones(len(groundtruth)) if weights is None else weights
        residuals = groundtruth - anchor.positions(estimate)
        total = float(w.sum())
        mean_q, mean_r = w @ estimate / total, w @ residuals / total
        q, r = estimate - mean_q, residuals - mean_r
        weighted_q, weighted_r = q * w[:, None], r * w[:, None]
        return cls(
            anchor=anchor,
            weight=total,
            mean_q=mean_q,
            mean_r=mean_r,
            scatter_qq=weighted_q.T @ q,
            scatter_rq=weighted_r.T @ q,
            scatter_rr=float(np.einsum("ni,ni->", weighted_r, r)),
        )

    def __add__(self, other: Moments) -> Moments:
        """Return the moments of both sets of pairs (Chan, Golub and LeVeque's merge)."""
        return self._combined(other, 1.0)

    def __sub__(self, other: Moments) -> Moments:
        """Return the moments without a part of the pairs that is in them."""
        return self._combined(other, -1.0)

    def _combined(self, other: Moments, sign: float) -> Moments:
        if self.anchor is not other.anchor:
            raise ValueError("moments combine only if their residuals have the same anchor")
        weight = self.weight + sign * other.weight
        if weight <= 0.0:
            return Moments.empty(self.anchor)
        share = sign * other.weight / weight
        step_q, step_r = other.mean_q - self.mean_q, other.mean_r - self.mean_r
        # For removal `share` is negative, and the same formulas hold.
        between = share * self.weight
        return Moments(
            anchor=self.anchor,
            weight=weight,
            mean_q=self.mean_q + share * step_q,
            mean_r=self.mean_r + share * step_r,
            scatter_qq=self.scatter_qq
            + sign * other.scatter_qq
            + between * np.outer(step_q, step_q),
            scatter_rq=self.scatter_rq
            + sign * other.scatter_rq
            + between * np.outer(step_r, step_q),
            scatter_rr=self.scatter_rr
            + sign * other.scatter_rr
            + between * float(step_r @ step_r),
        )

    @property
    def mean_p(self) -> Array:
        """Mean groundtruth position, (3,), metres."""
        mean: Array = self.anchor.positions(self.mean_q[None])[0] + self.mean_r
        return mean

    @property
    def covariance_pq(self) -> Array:
        """The matrix Sigma of Alg. 1, (3, 3), square metres."""
        linear = self.anchor.scale * self.anchor.rotation
        return (linear @ self.scatter_qq + self.scatter_rq) / self.weight

    @property
    def variance_q(self) -> float:
        """sigma^2 of the estimated positions in Alg. 1, square metres."""
        return float(np.trace(self.scatter_qq)) / self.weight

    def rmse(self, alignment: Similarity) -> float:
        """Return the root mean square of |p - (alignment of q)|, metres: the ATE, eq. (24)."""
        # p - S q = (A - S) q + r + (t_a - t), with small A - S and small r: nothing cancels.
        linear = self.anchor.scale * self.anchor.rotation - alignment.scale * alignment.rotation
        mean = linear @ self.mean_q + self.mean_r + self.anchor.translation - alignment.translation
        scatter = (
            np.trace(linear @ self.scatter_qq @ linear.T)
            + 2.0 * np.trace(linear @ self.scatter_rq.T)
            + self.scatter_rr
        )
        return float(np.sqrt(mean @ mean + max(float(scatter), 0.0) / self.weight))


@dataclass(frozen=True, eq=False)
class Alignment:
    """A similarity with what the data say about it.

    Attributes:
        similarity: Maps the estimate onto the groundtruth.
        states_used: Number of states that it was computed from.
        undetermined: Empty, or the sentence that says why the rotation is not determined by
            the states; rotation errors under this alignment mean nothing then.
    """

    similarity: Similarity
    states_used: int
    undetermined: str = ""


def solve(gauge: Gauge, moments: Moments) -> tuple[Similarity, str]:
    """Return the least-squares alignment, eq. (13) in the gauge, and why it is undetermined.

    Alg. 1 of the tutorial; for yaw its line 8 is replaced by eq. (18). The second value is empty
    where the positions determine the rotation. They don't where the least squares cost is as
    flat about some axis as the residuals are large: turning by a radian would cost no more than
    the errors themselves (a straight line, no motion, or an estimate unlike the groundtruth).
    """
    sigma = moments.covariance_pq
    rotation = np.eye(3)
    curvature = np.inf  # of the cost for the rotation about its least determined axis, m^2/rad^2
    if gauge.turns_freely:
        u, d, vt = np.linalg.svd(sigma)
        w = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])
        rotation = (u * w) @ vt
        curvature = float(d[1] + w[2] * d[2])
    elif gauge.turns_about_gravity_only:
        sine, cosine = sigma[1, 0] - sigma[0, 1], sigma[0, 0] + sigma[1, 1]
        rotation = _about_gravity(np.arctan2(sine, cosine))
        curvature = float(np.hypot(sine, cosine))
    # Line 9 of Alg. 1: trace(D W) is the trace of R^T Sigma, in every gauge.
    best_scale = 1.0
    if moments.variance_q > 0.0:
        best_scale = max(float(np.sum(rotation * sigma)) / moments.variance_q, 0.0)
    scaled = _with_translation(rotation, best_scale, moments)
    undetermined = _why_undetermined(gauge, moments, scaled, best_scale * curvature)
    if gauge.has_scale:
        return scaled, undetermined
    if not gauge.has_translation:
        return Similarity.identity(), ""
    return _with_translation(rotation, 1.0, moments), undetermined


def _with_translation(rotation: Array, scale: float, moments: Moments) -> Similarity:
    """Return the similarity that maps mean to mean: line 10 of Alg. 1."""
    return Similarity(rotation, moments.mean_p - scale * rotation @ moments.mean_q, scale)


def _why_undetermined(gauge: Gauge, moments: Moments, scaled: Similarity, curvature: float) -> str:
    """Compare the cost of a turn with the errors, a wrong scale of the estimate left out."""
    if not np.isfinite(curvature):
        return ""
    residual = moments.rmse(scaled)
    lever = float(np.sqrt(max(curvature, 0.0)))
    extent = scaled.scale**2 * moments.variance_q
    if lever > residual and curvature > _ROUNDING * extent:
        return ""
    axis = "gravity" if gauge.turns_about_gravity_only else "the direction of travel"
    return (
        f"the positions don't determine the alignment's rotation about {axis}: they extend "
        f"{lever:.2g} m to its side, with residuals of {residual:.2g} m (a straight line, no "
        "motion, or an estimate unlike the groundtruth)"
    )


def align(
    gauge: Gauge,
    groundtruth: Array,
    estimate: Array,
    weights: Array | None = None,
) -> Alignment:
    """Align N estimated positions with the groundtruth's (Alg. 1, or with eq. 18), (N, 3) each.

    Args:
        gauge: What the alignment may change.
        groundtruth: (N, 3), metres. For `planar` the height plays no part in the rotation.
        estimate: (N, 3), metres.
        weights: (N,) positive, per pair, such as `position_weights`; None for all alike.

    Raises:
        DegenerateGeometryError: Fewer states than the gauge needs, or no motion at all where a
            rotation is to be found.
    """
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
    similarity, undetermined = solve(gauge, moments)
    return Alignment(similarity, count, undetermined)


def _require_motion(who: str, positions: Array) -> None:
    extent = max(float(np.ptp(positions[:, axis])) for axis in range(3))
    if extent <= _ROUNDING * max(1.0, float(np.abs(positions[0]).max())):
        raise DegenerateGeometryError(
            f"the {who} does not move in the {len(positions)} states to be aligned, so no "
            "rotation can be found; use more states, the first alone (align states 1), or "
            "gauge translation"
        )


def align_first(
    gauge: Gauge,
    groundtruth_position: Array,
    groundtruth_rotation: Rotation | None,
    estimate_position: Array,
    estimate_rotation: Rotation | None,
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
        if groundtruth_rotation is None or estimate_rotation is None:
            raise DegenerateGeometryError(
                f"gauge {gauge.value} can't be aligned by the first state alone without "
                "orientations on both sides; align by more states"
            )
        between = np.asarray((groundtruth_rotation * estimate_rotation.inv()).as_quat())
        if gauge.turns_freely:
            rotation = Rotation.from_quat(between).as_matrix()
        else:
            if np.hypot(between[2], between[3]) < 1e-9:
                raise DegenerateGeometryError(
                    "the first state's rotations differ by half a turn about a level axis, which "
                    "leaves the yaw open; is z up in both trajectories?"
                )
            rotation = _about_gravity(float(lie.yaw(between)))
    translation = groundtruth_position - rotation @ estimate_position
    similarity = Similarity(rotation, translation if gauge.has_translation else np.zeros(3))
    return Alignment(similarity, 1)


def position_weights(covariances: Array, error_m: float) -> Array:
    """Return a scalar weight per state from pose covariances (N, 6, 6), position first.

    1 / (tr Sigma / 3 + e^2 / 3): the mean variance of an axis, with the size e of the errors
    themselves as a floor, so that an over-confident state doesn't rule the alignment.
    """
    variance = np.trace(covariances[:, :3, :3], axis1=1, axis2=2) / 3.0
    weights: Array = 1.0 / (variance + error_m**2 / 3.0)
    return weights


def _about_gravity(angle: float) -> Array:
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
