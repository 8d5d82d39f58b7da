"""Models of how the short motions of both sides are related, and their likelihoods.

A model is a hypothesis on the columns, with axes of the estimate's positions, a rotation of its
body, and a scale. About 1,300 models are ranked in closed form by moments. The likelihoods of the
best ones decide: residuals have Student's t distribution, with a scale per principal axis of the
groundtruth's motion. The estimate is predicted from the groundtruth, because noise of the estimate
as the regressor makes the scale smaller.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.diagnosis.hypotheses import (
    AS_READ,
    AXES_LOG_PRIORS,
    BOTH,
    ESTIMATE,
    GROUNDTRUTH,
    HYPOTHESES,
    MIRROR_LOG_PRIORS,
    MIRRORED,
    OTHER_BODY,
    PERMUTATIONS,
    PROPER,
    ROTATED_BODY,
    ROTATIONS,
    Hypothesis,
)
from trajeval_ros.diagnosis.input_pair import lengths
from trajeval_ros.diagnosis.short_motions import PoseEnds, ShortMotions
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.rotation_fit import best_rotations
from trajeval_ros.metrics.statistics import median

DEGREES_OF_FREEDOM = 4.0  # of the residuals: outliers count little, and noise as with a Gaussian
# Least scale of the residuals relative to the motion: axes and scales of the best estimators
# differ by as much, so a smaller residual is no evidence.
_LEAST_RESIDUAL = 0.02
MOST_INDEPENDENT = 25.0  # motions; more are not more evidence, because no model is exact
_RANKED = 9  # models with a likelihood, out of all
_LEAST_RATIO = 0.05  # of the usual length of motions: smaller projections are noise
_LARGEST_WEIGHT = 4.0  # of a squared residual relative to the mean, for the start of the iteration


@dataclass(frozen=True, eq=False)
class Model:
    """A relation of both sides, and how well it explains the motions."""

    hypothesis: Hypothesis
    axes: Floats  # (3, 3) signed permutation that is applied to the estimate's positions
    body: Floats  # (3, 3) rotation from the estimate's body to the groundtruth's
    log_prior: float
    agreement: float  # of the motions, 1 if they are equal and about 0 if they are unrelated
    log_likelihood: float = -np.inf
    scale: float = 1.0  # groundtruth metres per unit of the estimate

    @property
    def score(self) -> float:
        """The logarithm of the posterior probability, but for a constant."""
        return self.log_likelihood + self.log_prior

    @property
    def is_mirrored(self) -> bool:
        """Whether the axes are left-handed."""
        return float(np.linalg.det(self.axes)) < 0.0

    @property
    def changes_axes(self) -> bool:
        """Whether the positions have other axes than the rotations."""
        return bool((self.axes != np.eye(3)).any())

    @property
    def cause(self) -> str:
        """The name of the mistake in `causes.py`, or `AS_READ`."""
        cause = self.hypothesis.cause
        if not self.changes_axes or cause == ROTATIONS:
            return cause
        if cause != AS_READ:
            return "conventions"
        # Whole poses are mirrored, or only the positions have other axes.
        return "mirrored" if (self.axes == -np.eye(3)).all() else "axes_mixed"


@dataclass(frozen=True)
class Unrelated:
    """Logarithms of the likelihoods of models without a common motion."""

    motions: float  # nothing is related
    positions: float  # the displacements in the worlds are related, and the rotations are not
    scale: float  # of these displacements, groundtruth metres per unit of the estimate


def t_log_likelihood(residuals: Floats, iterations: int = 5) -> tuple[Floats, Floats]:
    """Return the mean log likelihood (...) of residuals (..., N), and their scale (...).

    The scale maximises the likelihood of Student's t, and is at least `_LEAST_RESIDUAL`.
    """
    squared, nu = residuals * residuals, DEGREES_OF_FREEDOM
    mean = squared.mean(axis=-1, keepdims=True)
    variance = 0.5 * np.minimum(squared, _LARGEST_WEIGHT * mean).mean(axis=-1)
    variance = np.maximum(variance, _LEAST_RESIDUAL**2)
    for _ in range(iterations):
        weights = (nu + 1.0) / (nu + squared / variance[..., None])
        variance = np.maximum((weights * squared).mean(axis=-1), _LEAST_RESIDUAL**2)
    tails = np.log1p(squared / variance[..., None] / nu).mean(axis=-1)
    return -0.5 * np.log(variance) - 0.5 * (nu + 1.0) * tails, np.sqrt(variance)


def bounded(vectors: Floats) -> Floats:
    """Return vectors (N, 3) with limited lengths: without a unit, and with small outliers."""
    size = lengths(vectors)
    return vectors / (size + 2.0 * max(median(size), 1e-12))[:, None]


@dataclass(frozen=True, eq=False)
class GroundtruthMotions:
    """The groundtruth's motions in the axes of its body, and the units of the residuals."""

    ends: PoseEnds

    @functools.cached_property
    def motions(self) -> tuple[Floats, Floats]:
        """Rotation vectors and displacements (N, 3)."""
        return self.ends.body_motions()

    @functools.cached_property
    def bounded(self) -> tuple[Floats, Floats]:
        """The motions with limited lengths."""
        rotations, displacements = map(bounded, self.motions)
        return rotations, displacements

    @functools.cached_property
    def units(self) -> tuple[Floats, Floats]:
        """Units (N,) of the residuals of rotations and displacements.

        Errors have a constant part, and a part that grows with the motion.
        """
        rotation, displacement = map(lengths, self.motions)
        return (
            rotation + median(rotation) + 1e-9,
            displacement + median(displacement) + 1e-9,
        )

    @functools.cached_property
    def log_units(self) -> float:
        """The logarithm of the determinant of the units."""
        rotation, displacement = self.units
        total = float(np.log(displacement).sum())
        return 3.0 * (total + (self.ends.quaternions is not None) * float(np.log(rotation).sum()))

    @functools.cached_property
    def principal_axes(self) -> tuple[Floats, Floats]:
        """Axes (3, 3) of rotations and displacements.

        With these axes, no common rotation changes a likelihood.
        """
        one, other = (np.linalg.eigh(rows.T @ rows)[1] for rows in self.bounded)
        return one, other


@dataclass(frozen=True, eq=False)
class ReadMotions:
    """The motions as a hypothesis reads them, and what all its models share."""

    motions: ShortMotions  # with the hypothesis applied to both sides
    of_groundtruth: GroundtruthMotions

    @property
    def groundtruth(self) -> tuple[Floats, Floats]:
        """Rotation vectors and displacements (N, 3) in the axes of the groundtruth's body."""
        return self.of_groundtruth.motions

    @functools.cached_property
    def rotations(self) -> Floats:
        """Rotation vectors (N, 3) of the estimate."""
        return self.motions.estimate.body_motions()[0]

    @functools.cached_property
    def steps(self) -> Floats:
        """Displacements (N, 3) of the estimate in its world."""
        positions = self.motions.estimate.positions
        return np.asarray(positions[1] - positions[0])

    @functools.cached_property
    def to_world(self) -> Floats:
        """Rotations (N, 3, 3) of the estimate at the starts."""
        quaternions = self.motions.estimate.quaternions
        if quaternions is None:
            return np.broadcast_to(np.eye(3), (len(self.motions), 3, 3))
        return lie.to_matrix(quaternions[0])

    def displacements(self, axes: Floats) -> Floats:
        """Return displacements (N, 3) in the estimate's body, with axes of its positions."""
        return np.asarray(np.einsum("nmb,nm->nb", self.to_world, self.steps @ axes.T))

    def moments(self, axes: Floats) -> Floats:
        """Return moments (P, 3, 3) of both sides' motions, by axes (P, 3, 3) of the positions."""
        rotations, displacements = self.of_groundtruth.bounded
        steps = bounded(self.steps)
        count = len(steps)
        products = (displacements[:, :, None] * steps[:, None, :]).reshape(count, 9)
        in_body = (products.T @ self.to_world.reshape(count, 9)).reshape(3, 3, 3, 3)
        moments = np.einsum("akmb,pmk->pab", in_body, axes) / _norm(displacements, steps)
        if self.motions.has_orientations:
            other = bounded(self.rotations)
            moments = moments + rotations.T @ other / _norm(rotations, other)
        return np.asarray(moments)


def _norm(one: Floats, other: Floats) -> float:
    return float(np.sqrt((one**2).sum() * (other**2).sum())) + 1e-300


class ModelScores:
    """Ranks models of short motions, and computes their likelihoods."""

    def __init__(self, motions: ShortMotions) -> None:
        """Prepare motions; there is at least one."""
        self.motions = motions
        # The weight of a motion in the evidence.
        self.weight = min(motions.independent, MOST_INDEPENDENT) / max(len(motions), 1)
        self._read: dict[Hypothesis, ReadMotions] = {}
        self._groundtruth: dict[str, GroundtruthMotions] = {}  # by cause

    @property
    def evidence(self) -> float:
        """The number of independent motions that count."""
        return self.weight * len(self.motions)

    def read(self, hypothesis: Hypothesis) -> ReadMotions:
        """Return the motions as a hypothesis reads them."""
        if hypothesis not in self._read:
            given, changed = self.motions, hypothesis.side in (GROUNDTRUTH, BOTH)
            # Most hypotheses are about the estimate alone, and share the groundtruth's motions.
            key = hypothesis.cause if changed else AS_READ
            if key not in self._groundtruth:
                ends = hypothesis.applied(GROUNDTRUTH, given.groundtruth)
                self._groundtruth[key] = GroundtruthMotions(ends)
            of_groundtruth = self._groundtruth[key]
            motions = replace(
                given,
                groundtruth=of_groundtruth.ends,
                groundtruth_later=hypothesis.applied(GROUNDTRUTH, given.groundtruth_later),
                groundtruth_earlier=hypothesis.applied(GROUNDTRUTH, given.groundtruth_earlier),
                estimate=hypothesis.applied(ESTIMATE, given.estimate),
            )
            self._read[hypothesis] = ReadMotions(motions, of_groundtruth)
        return self._read[hypothesis]

    def likeliest(self, hypotheses: Sequence[Hypothesis]) -> list[Model]:
        """Return the best models of hypotheses and those as read, with likelihoods, unsorted."""
        models: list[Model] = []
        ranks: list[Floats] = []
        for hypothesis in hypotheses:
            for agreements, priors, bodies, rows in self._ranked(hypothesis):
                ranks.append(
                    priors
                    - 3.0
                    * self.evidence
                    * np.log(np.maximum(1.0 - agreements, _LEAST_RESIDUAL**2))
                )
                models += [
                    Model(hypothesis, PERMUTATIONS[row], body, float(prior), float(agreement))
                    for row, body, prior, agreement in zip(
                        rows, bodies, priors, agreements, strict=True
                    )
                ]
        order = np.argsort(-np.concatenate(ranks))
        chosen = [models[k] for k in order[:_RANKED]]
        # As read, with equal bodies and with any rotation between them.
        plain = [m for m in models if m.hypothesis.cause == AS_READ and not m.changes_axes]
        chosen += [model for model in plain if model not in chosen]
        return self.with_likelihoods(chosen)

    def _ranked(self, hypothesis: Hypothesis) -> list[tuple[Floats, Floats, Floats, Floats]]:
        """Return agreements, priors, bodies and rows of the axes, by kind of body.

        The kinds are equal axes, permuted axes, and any rotation.
        """
        read = self.read(hypothesis)
        oriented = self.motions.has_orientations
        rows = np.array([0, MIRRORED])
        if oriented:
            rows = np.arange(len(PERMUTATIONS)) if hypothesis.with_axes else np.array([0])
        moments = read.moments(PERMUTATIONS[rows])
        traces, rotations = best_rotations(moments)
        priors = hypothesis.log_prior + AXES_LOG_PRIORS[rows]
        if not oriented:  # the rotation is that of the world
            return [(traces, priors, rotations, rows)]
        permuted = np.einsum("qab,pab->pq", PROPER, moments)
        best = permuted[:, 1:].argmax(axis=1) + 1
        body_priors = np.where(rows == MIRRORED, MIRROR_LOG_PRIORS[best], OTHER_BODY)
        same = np.broadcast_to(np.eye(3), rotations.shape)
        chosen = permuted[np.arange(len(rows)), best]
        return [
            (permuted[:, 0] / 2.0, priors, same, rows),
            (chosen / 2.0, priors + body_priors, PROPER[best], rows),
            (traces / 2.0, priors + ROTATED_BODY, rotations, rows),
        ]

    def with_likelihoods(self, models: list[Model]) -> list[Model]:
        """Return models with their scales and likelihoods."""
        residuals, scales = [], []
        for model in models:
            read = self.read(model.hypothesis)
            rotations, displacements = read.groundtruth
            rotated = read.displacements(model.axes) @ model.body.T
            ratio = _ratio(displacements, rotated)
            scales.append(1.0 / ratio)
            of_rotations, of_displacements = self._in_units(
                read,
                read.rotations @ model.body.T - rotations,
                (rotated - displacements * ratio) / self.size_ratio,
            )
            kinds = [of_displacements.T]
            if self.motions.has_orientations:
                kinds.append(of_rotations.T)
            residuals.append(np.concatenate(kinds))
        means = t_log_likelihood(np.array(residuals))[0].sum(axis=1)
        return [
            replace(model, scale=scale, log_likelihood=self._total(model.hypothesis, float(mean)))
            for model, scale, mean in zip(models, scales, means, strict=True)
        ]

    def _in_units(
        self, read: ReadMotions, rotations: Floats, displacements: Floats
    ) -> tuple[Floats, Floats]:
        """Return residuals (N, 3) along the principal axes, relative to the motion."""
        rotation_axes, displacement_axes = read.of_groundtruth.principal_axes
        rotation_unit, displacement_unit = (unit[:, None] for unit in read.of_groundtruth.units)
        return (
            rotations @ rotation_axes / rotation_unit,
            displacements @ displacement_axes / displacement_unit,
        )

    def _total(self, hypothesis: Hypothesis, mean: float) -> float:
        """Return the log likelihood in the units of the motions."""
        return self.evidence * mean - self.weight * self.read(hypothesis).of_groundtruth.log_units

    def log_odds_of_worlds(self, model: Model, one: Floats, other: Floats) -> float:
        """Return the log odds of rotations (N, 4) from the estimate's world against others.

        Only displacements are compared.
        """
        ends = self.motions.groundtruth.positions
        steps, read = ends[1] - ends[0], self.read(model.hypothesis)
        unit = read.of_groundtruth.units[1][:, None] * self.size_ratio
        rows = []
        for worlds in (one, other):
            rotated = lie.rotate(worlds, read.steps @ model.axes.T)
            rows.append(((rotated - steps * _ratio(steps, rotated)) / unit).T)
        likelihoods = t_log_likelihood(np.stack(rows))[0].sum(axis=1)
        return self.evidence * float(likelihoods[0] - likelihoods[1])

    @functools.cached_property
    def size_ratio(self) -> float:
        """Units of the estimate per metre, equal for all models, for numbers near 1."""
        sizes = [
            median(lengths(poses.positions[1] - poses.positions[0]))
            for poses in (self.motions.estimate, self.motions.groundtruth)
        ]
        return max(sizes[0], 1e-12) / max(sizes[1], 1e-12)

    @functools.cached_property
    def unrelated(self) -> Unrelated:
        """The likelihoods without a relation of the rotations."""
        hypothesis = HYPOTHESES[0]
        read = self.read(hypothesis)
        ends = self.motions.groundtruth
        steps = ends.positions[1] - ends.positions[0]
        moment = bounded(steps).T @ bounded(read.steps)
        traces, worlds = best_rotations(np.stack([moment, -moment]))
        is_mirrored = traces[1] > traces[0] + 1e-3
        rotated = read.steps @ worlds[int(is_mirrored)].T * (-1.0 if is_mirrored else 1.0)
        ratio = _ratio(steps, rotated)
        rest = (rotated - steps * ratio) / self.size_ratio
        if ends.quaternions is not None:
            rest = lie.rotate(lie.conjugate(ends.quaternions[0]), rest)
        in_body = read.displacements(np.eye(3)) / self.size_ratio
        of_rotations, nothing = self._in_units(read, read.rotations, in_body)
        _, of_positions = self._in_units(read, read.rotations, rest)
        rows = np.stack([nothing.T, of_positions.T, of_rotations.T])
        moving, related, turning = t_log_likelihood(rows)[0].sum(axis=1)
        if not self.motions.has_orientations:
            turning = 0.0
        return Unrelated(
            self._total(hypothesis, float(moving + turning)),
            self._total(hypothesis, float(related + turning)),
            1.0 / ratio,
        )


def _ratio(groundtruth: Floats, estimate: Floats) -> float:
    """Return units of the estimate per metre by displacements (N, 3); its noise is no bias."""
    squared = np.einsum("ni,ni->n", groundtruth, groundtruth)
    large = squared > median(squared)
    if not large.any():
        return 1.0
    along = np.einsum("ni,ni->n", groundtruth, estimate)[large] / squared[large]
    usual = median(lengths(estimate[large]) / np.sqrt(squared[large]))
    return max(median(along), _LEAST_RATIO * usual, 1e-9)
