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
from typing import NamedTuple

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
from trajeval_ros.diagnosis.short_motions import PoseEnds, ShortMotions
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths
from trajeval_ros.geometry.so3 import best_rotations
from trajeval_ros.metrics.statistics import median

DEGREES_OF_FREEDOM = 4.0  # of the residuals: outliers count little, and noise as with a Gaussian
# Least scale of the residuals relative to the motion: axes and scales of the best estimators
# differ by as much, so a smaller residual is no evidence.
_LEAST_RESIDUAL = 0.02
MOST_INDEPENDENT = 25.0  # motions; more are not more evidence, because no model is exact
_RANKED = 9  # models with a likelihood, out of all
_LEAST_RATIO = 0.05  # of the usual length of motions: smaller projections are noise
_LARGEST_WEIGHT = 4.0  # of a squared residual relative to the mean, for the start of the iteration
_IDENTITY = np.eye(3)


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
    def mirrors_poses(self) -> bool:
        """Whether whole poses are mirrored: the axes are -1, and the body is rotated."""
        return bool((self.axes == -_IDENTITY).all())

    @property
    def changes_axes(self) -> bool:
        """Whether the positions have other axes than the rotations."""
        return bool((self.axes != _IDENTITY).any())

    @property
    def cause(self) -> str:
        """The name of the mistake in `causes.py`, or `AS_READ`."""
        cause = self.hypothesis.cause
        if not self.changes_axes or cause == ROTATIONS:
            return cause
        if cause != AS_READ:
            return "conventions"
        return "mirrored" if self.mirrors_poses else "axes_mixed"


class Candidates(NamedTuple):
    """The columns of K models of a hypothesis, without likelihoods."""

    axes: Floats  # (K, 3, 3)
    bodies: Floats  # (K, 3, 3)
    log_priors: Floats  # (K,)
    agreements: Floats  # (K,)


class Unrelated(NamedTuple):
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
    """The groundtruth's motions in the axes of its body, and the units of the residuals.

    All are pairs of rotation vectors and displacements.
    """

    motions: Sequence[Floats]  # (N, 3)
    bounded: Sequence[Floats]  # (N, 3), with limited lengths
    # (N,) units of the residuals. Errors have a constant part, and one that grows with the motion.
    units: Sequence[Floats]
    # (3, 3) principal axes: with them, no common rotation changes a likelihood.
    axes: Sequence[Floats]
    log_units: float  # logarithm of the determinant of the units

    @classmethod
    def of(cls, ends: PoseEnds) -> GroundtruthMotions:
        """Return the motions between poses."""
        motions = ends.body_motions()
        limited = [bounded(rows) for rows in motions]
        units = [size + median(size) + 1e-9 for size in map(lengths, motions)]
        kinds = units if ends.quaternions is not None else units[1:]
        log_units = 3.0 * sum(float(np.log(unit).sum()) for unit in kinds)
        axes = [np.linalg.eigh(rows.T @ rows)[1] for rows in limited]
        return cls(motions, limited, units, axes, log_units)

    def in_units(self, kind: int, residuals: Floats) -> Floats:
        """Return residuals (N, 3) of rotations (0) or displacements (1) in their units (3, N)."""
        return (residuals @ self.axes[kind] / self.units[kind][:, None]).T


@dataclass(frozen=True, eq=False)
class ReadMotions:
    """The motions as a hypothesis reads them, and what all its models share."""

    motions: ShortMotions  # with the hypothesis applied to both sides
    truth: GroundtruthMotions
    rotations: Floats  # (N, 3) rotation vectors of the estimate
    to_world: Floats  # (N, 3, 3) rotations of the estimate at the starts

    @classmethod
    def of(cls, motions: ShortMotions, truth: GroundtruthMotions) -> ReadMotions:
        """Return the motions with those of the groundtruth."""
        quaternions = motions.estimate.quaternions
        to_world = np.broadcast_to(_IDENTITY, (len(motions), 3, 3))
        if quaternions is not None:
            to_world = lie.to_matrix(quaternions[0])
        return cls(motions, truth, motions.estimate.body_motions()[0], to_world)

    def displacements(self, axes: Floats) -> Floats:
        """Return displacements (N, 3) in the estimate's body, with axes of its positions."""
        steps = self.motions.estimate.displacements
        return np.asarray(np.einsum("nmb,nm->nb", self.to_world, steps @ axes.T))

    def moments(self, axes: Floats) -> Floats:
        """Return moments (P, 3, 3) of both sides' motions, by axes (P, 3, 3) of the positions."""
        rotations, displacements = self.truth.bounded
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
        self._truth: dict[str, GroundtruthMotions] = {}  # by cause
        # Units of the estimate per metre, equal for all models, for numbers near 1.
        sizes = [
            max(median(lengths(side.displacements)), 1e-12)
            for side in (motions.estimate, motions.groundtruth)
        ]
        self.size_ratio = sizes[0] / sizes[1]

    def read(self, hypothesis: Hypothesis) -> ReadMotions:
        """Return the motions as a hypothesis reads them."""
        if hypothesis not in self._read:
            # Most hypotheses are about the estimate alone, and share the groundtruth's motions.
            key = hypothesis.cause if hypothesis.side in (GROUNDTRUTH, BOTH) else AS_READ
            around = tuple(hypothesis.applied(GROUNDTRUTH, ends) for ends in self.motions.around)
            if key not in self._truth:
                self._truth[key] = GroundtruthMotions.of(around[0])
            estimate = hypothesis.applied(ESTIMATE, self.motions.estimate)
            motions = replace(self.motions, around=around, estimate=estimate)
            self._read[hypothesis] = ReadMotions.of(motions, self._truth[key])
        return self._read[hypothesis]

    def likeliest(self, hypotheses: Sequence[Hypothesis]) -> list[Model]:
        """Return the best models of hypotheses and those as read, with likelihoods, unsorted."""
        groups = [(one, candidates) for one in hypotheses for candidates in self._candidates(one)]
        costs = [
            3.0 * self.evidence * np.log(np.maximum(1.0 - some.agreements, _LEAST_RESIDUAL**2))
            - some.log_priors
            for _, some in groups
        ]
        begins = np.cumsum([0, *map(len, costs)])
        chosen = list(np.argsort(np.concatenate(costs))[:_RANKED])
        # As read, with equal bodies and with any rotation between them: the first row of each.
        as_read = [at for at, (one, _) in enumerate(groups) if one.cause == AS_READ]
        chosen += [begins[at] for at in as_read if begins[at] not in chosen]
        models = []
        for number in chosen:
            at = int(np.searchsorted(begins, number, side="right")) - 1
            hypothesis, some = groups[at]
            axes, body, log_prior, agreement = (column[number - begins[at]] for column in some)
            models.append(Model(hypothesis, axes, body, float(log_prior), float(agreement)))
        return self.with_likelihoods(models)

    def _candidates(self, hypothesis: Hypothesis) -> Iterator[Candidates]:
        """Yield the models of a hypothesis: with equal and permuted axes, and any rotation."""
        rows = np.array([0, MIRRORED])
        if self.motions.has_orientations:
            rows = np.arange(len(PERMUTATIONS)) if hypothesis.with_axes else rows[:1]
        axes, priors = PERMUTATIONS[rows], hypothesis.log_prior + AXES_LOG_PRIORS[rows]
        moments = self.read(hypothesis).moments(axes)
        traces, rotations = best_rotations(moments)
        if not self.motions.has_orientations:  # a rotation of the world
            yield Candidates(axes, rotations, priors, traces)
            return
        permuted = np.einsum("qab,pab->pq", PROPER, moments) / 2.0
        best = permuted[:, 1:].argmax(axis=1) + 1
        of_bodies = np.where(rows == MIRRORED, MIRROR_LOG_PRIORS[best], OTHER_BODY)
        equal = np.broadcast_to(_IDENTITY, rotations.shape)
        yield Candidates(axes, equal, priors, permuted[:, 0])
        yield Candidates(axes, PROPER[best], priors + of_bodies, permuted[:, 1:].max(axis=1))
        yield Candidates(axes, rotations, priors + ROTATED_BODY, traces / 2.0)

    def with_likelihoods(self, models: list[Model]) -> list[Model]:
        """Return models with their scales and likelihoods."""
        residuals, scales = [], []
        for model in models:
            read = self.read(model.hypothesis)
            rotations, displacements = read.truth.motions
            rotated = read.displacements(model.axes) @ model.body.T
            ratio, rest = self._apart(displacements, rotated)
            scales.append(1.0 / ratio)
            kinds = [read.truth.in_units(1, rest)]
            if self.motions.has_orientations:
                rotation_errors = read.rotations @ model.body.T - rotations
                kinds.append(read.truth.in_units(0, rotation_errors))
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
        return self.evidence * mean - self.weight * self.read(hypothesis).truth.log_units

    def log_odds_of_worlds(self, model: Model, one: Floats, other: Floats) -> float:
        """Return the log odds of rotations (N, 4) from the estimate's world against others.

        Only displacements are compared.
        """
        read, steps = self.read(model.hypothesis), self.motions.groundtruth.displacements
        given = self.read(model.hypothesis).motions.estimate.displacements @ model.axes.T
        rows = [
            (self._apart(steps, lie.rotate(worlds, given))[1] / read.truth.units[1][:, None]).T
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
        rows = np.stack([read.truth.in_units(kind, one) for kind, one in kinds])
        moving, related, turning = map(float, t_log_likelihood(rows)[0].sum(axis=1))
        if not self.motions.has_orientations:
            turning = 0.0
        nothing, positions = (
            self._total(HYPOTHESES[0], one + turning) for one in (moving, related)
        )
        return Unrelated(nothing, positions, 1.0 / ratio)
