"""Models of how the short motions of both sides are related, and their likelihoods.

A model is a hypothesis on the columns, with axes of the estimate's positions, a rotation of its
body, and a scale. About 1,300 models are ranked in closed form by moments. The likelihoods of the
best ones decide: residuals have Student's t distribution, with a scale per principal axis of the
groundtruth's motion. The estimate is predicted from the groundtruth, because noise of the estimate
as the regressor makes the scale smaller.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
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
    def bounded(self) -> list[Floats]:
        """The motions with limited lengths."""
        return [bounded(rows) for rows in self.motions]

    @functools.cached_property
    def units(self) -> list[Floats]:
        """Units (N,) of the residuals of rotations and displacements.

        Errors have a constant part, and a part that grows with the motion.
        """
        return [size + median(size) + 1e-9 for size in map(lengths, self.motions)]

    @functools.cached_property
    def log_units(self) -> float:
        """The logarithm of the determinant of the units."""
        kinds = self.units if self.ends.quaternions is not None else self.units[1:]
        return 3.0 * sum(float(np.log(unit).sum()) for unit in kinds)

    @functools.cached_property
    def principal_axes(self) -> list[Floats]:
        """Axes (3, 3) of rotations and displacements.

        With these axes, no common rotation changes a likelihood.
        """
        return [np.linalg.eigh(rows.T @ rows)[1] for rows in self.bounded]

    def in_units(self, kind: int, residuals: Floats) -> Floats:
        """Return residuals (N, 3) of rotations (0) or displacements (1) in their units (3, N)."""
        return (residuals @ self.principal_axes[kind] / self.units[kind][:, None]).T


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
    def to_world(self) -> Floats:
        """Rotations (N, 3, 3) of the estimate at the starts."""
        quaternions = self.motions.estimate.quaternions
        if quaternions is None:
            return np.broadcast_to(np.eye(3), (len(self.motions), 3, 3))
        return lie.to_matrix(quaternions[0])

    def displacements(self, axes: Floats) -> Floats:
        """Return displacements (N, 3) in the estimate's body, with axes of its positions."""
        steps = self.motions.estimate.displacements
        return np.asarray(np.einsum("nmb,nm->nb", self.to_world, steps @ axes.T))

    def moments(self, axes: Floats) -> Floats:
        """Return moments (P, 3, 3) of both sides' motions, by axes (P, 3, 3) of the positions."""
        rotations, displacements = self.of_groundtruth.bounded
        steps = bounded(self.motions.estimate.displacements)
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
        self.evidence = min(motions.independent, MOST_INDEPENDENT)  # independent motions
        self.weight = self.evidence / len(motions)  # of a motion in the evidence
        self._read: dict[Hypothesis, ReadMotions] = {}
        self._groundtruth: dict[str, GroundtruthMotions] = {}  # by cause
        # Units of the estimate per metre, equal for all models, for numbers near 1.
        sizes = [
            max(median(lengths(side.displacements)), 1e-12)
            for side in (motions.estimate, motions.groundtruth)
        ]
        self.size_ratio = sizes[0] / sizes[1]

    def read(self, hypothesis: Hypothesis) -> ReadMotions:
        """Return the motions as a hypothesis reads them."""
        if hypothesis not in self._read:
            changed = hypothesis.side in (GROUNDTRUTH, BOTH)
            # Most hypotheses are about the estimate alone, and share the groundtruth's motions.
            key = hypothesis.cause if changed else AS_READ
            around = tuple(hypothesis.applied(GROUNDTRUTH, ends) for ends in self.motions.around)
            if key not in self._groundtruth:
                self._groundtruth[key] = GroundtruthMotions(around[0])
            estimate = hypothesis.applied(ESTIMATE, self.motions.estimate)
            motions = replace(self.motions, around=around, estimate=estimate)
            self._read[hypothesis] = ReadMotions(motions, self._groundtruth[key])
        return self._read[hypothesis]

    def likeliest(self, hypotheses: Sequence[Hypothesis]) -> list[Model]:
        """Return the best models of hypotheses and those as read, with likelihoods, unsorted."""
        models = [model for hypothesis in hypotheses for model in self._all_of(hypothesis)]
        misfits = np.maximum([1.0 - model.agreement for model in models], _LEAST_RESIDUAL**2)
        priors = np.array([model.log_prior for model in models])
        order = np.argsort(3.0 * self.evidence * np.log(misfits) - priors)
        chosen = [models[k] for k in order[:_RANKED]]
        # As read, with equal bodies and with any rotation between them.
        plain = [m for m in models if m.hypothesis.cause == AS_READ and not m.changes_axes]
        return self.with_likelihoods([*chosen, *(m for m in plain if m not in chosen)])

    def _all_of(self, hypothesis: Hypothesis) -> Iterator[Model]:
        """Yield the models of a hypothesis: with equal and permuted axes, and any rotation."""
        rows = np.array([0, MIRRORED])
        if self.motions.has_orientations:
            rows = np.arange(len(PERMUTATIONS)) if hypothesis.with_axes else rows[:1]
        moments = self.read(hypothesis).moments(PERMUTATIONS[rows])
        traces, rotations = best_rotations(moments)
        priors = hypothesis.log_prior + AXES_LOG_PRIORS[rows]
        kinds = [(traces, priors, rotations)]  # without orientations, a rotation of the world
        if self.motions.has_orientations:
            permuted = np.einsum("qab,pab->pq", PROPER, moments)
            best = permuted[:, 1:].argmax(axis=1) + 1
            of_bodies = np.where(rows == MIRRORED, MIRROR_LOG_PRIORS[best], OTHER_BODY)
            kinds = [
                (permuted[:, 0] / 2.0, priors, np.broadcast_to(np.eye(3), rotations.shape)),
                (permuted[:, 1:].max(axis=1) / 2.0, priors + of_bodies, PROPER[best]),
                (traces / 2.0, priors + ROTATED_BODY, rotations),
            ]
        for agreements, log_priors, bodies in kinds:
            for k, row in enumerate(rows):
                yield Model(
                    hypothesis,
                    PERMUTATIONS[row],
                    bodies[k],
                    float(log_priors[k]),
                    float(agreements[k]),
                )

    def with_likelihoods(self, models: list[Model]) -> list[Model]:
        """Return models with their scales and likelihoods."""
        residuals, scales = [], []
        for model in models:
            read = self.read(model.hypothesis)
            rotations, displacements = read.groundtruth
            rotated = read.displacements(model.axes) @ model.body.T
            ratio, rest = self._apart(displacements, rotated)
            scales.append(1.0 / ratio)
            kinds = [read.of_groundtruth.in_units(1, rest)]
            if self.motions.has_orientations:
                turned = read.rotations @ model.body.T - rotations
                kinds.append(read.of_groundtruth.in_units(0, turned))
            residuals.append(np.concatenate(kinds))
        means = t_log_likelihood(np.array(residuals))[0].sum(axis=1)
        return [
            replace(model, scale=scale, log_likelihood=self._total(model.hypothesis, float(mean)))
            for model, scale, mean in zip(models, scales, means, strict=True)
        ]

    def _apart(self, groundtruth: Floats, estimate: Floats) -> tuple[float, Floats]:
        """Return units of the estimate per metre by displacements (N, 3), and the residuals.

        Noise of the estimate is no bias of the ratio.
        """
        squared = np.einsum("ni,ni->n", groundtruth, groundtruth)
        large, ratio = squared > median(squared), 1.0
        if large.any():
            along = np.einsum("ni,ni->n", groundtruth, estimate)[large] / squared[large]
            usual = median(lengths(estimate[large]) / np.sqrt(squared[large]))
            ratio = max(median(along), _LEAST_RATIO * usual, 1e-9)
        return ratio, (estimate - groundtruth * ratio) / self.size_ratio

    def _total(self, hypothesis: Hypothesis, mean: float) -> float:
        """Return the log likelihood in the units of the motions."""
        return self.evidence * mean - self.weight * self.read(hypothesis).of_groundtruth.log_units

    def log_odds_of_worlds(self, model: Model, one: Floats, other: Floats) -> float:
        """Return the log odds of rotations (N, 4) from the estimate's world against others.

        Only displacements are compared.
        """
        read, steps = self.read(model.hypothesis), self.motions.groundtruth.displacements
        given = self.read(model.hypothesis).motions.estimate.displacements @ model.axes.T
        rows = [
            (
                self._apart(steps, lie.rotate(worlds, given))[1]
                / read.of_groundtruth.units[1][:, None]
            ).T
            for worlds in (one, other)
        ]
        likelihoods = t_log_likelihood(np.stack(rows))[0].sum(axis=1)
        return self.evidence * float(likelihoods[0] - likelihoods[1])

    @functools.cached_property
    def unrelated(self) -> Unrelated:
        """The likelihoods without a relation of the rotations."""
        read, ends = self.read(HYPOTHESES[0]), self.motions.groundtruth
        steps = self.motions.estimate.displacements
        moment = bounded(ends.displacements).T @ bounded(steps)
        traces, worlds = best_rotations(np.stack([moment, -moment]))
        is_mirrored = traces[1] > traces[0] + 1e-3
        rotated = steps @ worlds[int(is_mirrored)].T * (-1.0 if is_mirrored else 1.0)
        ratio, rest = self._apart(ends.displacements, rotated)
        if ends.quaternions is not None:
            rest = lie.rotate(lie.conjugate(ends.quaternions[0]), rest)
        kinds = [
            (1, read.displacements(np.eye(3)) / self.size_ratio),
            (1, rest),
            (0, read.rotations),
        ]
        rows = np.stack([read.of_groundtruth.in_units(kind, one) for kind, one in kinds])
        moving, related, turning = map(float, t_log_likelihood(rows)[0].sum(axis=1))
        if not self.motions.has_orientations:
            turning = 0.0
        nothing, positions = (
            self._total(HYPOTHESES[0], one + turning) for one in (moving, related)
        )
        return Unrelated(nothing, positions, 1.0 / ratio)
