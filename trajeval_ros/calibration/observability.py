"""Observability of the parameters, and the choice of those that are fitted.

A small standard deviation is no proof: on a static recording, differentiated noise looks like
information. However, the Jacobian can be computed from either trajectory, and their noises are
independent. Where the two Jacobians agree, they show actual motion. Their correlation, the
reliability, is at least 0.89 on recordings that determine an offset, and at most 0.05 where none
is observable.

All directions are fitted that are observable and have standard deviations.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.increments import (
    BODY_ROTATION,
    COLUMNS,
    LEVER,
    OFFSET,
    SCALE,
    SKEW,
    Increments,
    Unknowns,
)
from trajeval_ros.calibration.robust_fit import Fit, fit
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import Gauge

LEAST_RELIABILITY = 0.5
# Least rms of (R_j - R_i) v for an observable lever arm, for increments without orientations.
_LEAST_TURN = 0.02


@dataclass(frozen=True, eq=False)
class Directions:
    """The principal directions of one parameter and their reliability."""

    directions: Floats  # (k, k), orthonormal rows
    reliability: Floats  # (k,), in [-1, 1]

    @property
    def seen(self) -> Booleans:
        """Which directions are observable, (k,)."""
        seen: Booleans = self.reliability >= LEAST_RELIABILITY
        return seen


def observability(increments: Increments, fitted: Fit) -> dict[str, Directions]:
    """Return the directions of `offset`, `skew`, `rotation` and `lever` at a solution."""
    rows = fitted.linearised.rows
    jacobian_with_swapped_sides, known = increments.jacobian_with_swapped_sides(
        fitted.unknowns, rows
    )
    size = jacobian_with_swapped_sides.shape[1]
    weights = np.repeat(fitted.weights, 3, axis=1)[known, :size]
    jacobian, jacobian_with_swapped_sides = (
        fitted.linearised.jacobian[known],
        jacobian_with_swapped_sides[known],
    )
    blocks = {"offset": OFFSET, "skew": SKEW}
    if increments.has_rotations:
        blocks |= {"rotation": BODY_ROTATION, "lever": LEVER}
    by_name = {
        name: _directions(
            jacobian[..., columns], jacobian_with_swapped_sides[..., columns], weights
        )
        for name, columns in blocks.items()
    }
    if increments.has_lever and not increments.has_rotations:
        by_name["lever"] = _lever_directions(increments.body_rotation_change[rows])
    return by_name


def _directions(
    jacobian: Floats, jacobian_with_swapped_sides: Floats, weights: Floats
) -> Directions:
    """Return the directions of a parameter from both Jacobians (N, 3 or 6, k) and weights."""

    def product(left: Floats, right: Floats) -> Floats:
        weighted = left * weights[..., None]
        summed: Floats = np.tensordot(weighted, right, axes=([0, 1], [0, 1]))
        return summed

    mine, theirs, both = (
        product(jacobian, jacobian),
        product(jacobian_with_swapped_sides, jacobian_with_swapped_sides),
        product(jacobian, jacobian_with_swapped_sides),
    )
    directions = np.linalg.eigh(mine + theirs)[1].T
    along = [
        np.einsum("ka,ab,kb->k", directions, matrix, directions) for matrix in (mine, theirs, both)
    ]
    size = np.sqrt(np.maximum(along[0], 0.0) * np.maximum(along[1], 0.0))
    reliability = np.where(size > 0.0, along[2] / np.where(size > 0.0, size, 1.0), 0.0)
    return Directions(directions, np.clip(reliability, -1.0, 1.0))


def _lever_directions(changes: Floats) -> Directions:
    """Return the directions of a lever arm; reliability 1 if they rotate enough, else 0."""
    values, vectors = np.linalg.eigh(
        np.einsum("nab,nac->bc", changes, changes) / max(len(changes), 1)
    )
    enough = np.sqrt(np.maximum(values, 0.0)) >= _LEAST_TURN
    return Directions(vectors.T, enough.astype(np.float64))


_FEWEST_PAIRS = 30
COLUMNS_OF = {
    "offset": OFFSET,
    "skew": SKEW,
    "rotation": BODY_ROTATION,
    "lever": LEVER,
    "scale": SCALE,
}
_NO_SKEW = "the run is too short to estimate a clock skew, so none is estimated"
_NO_BODY = (
    "the run is too short to estimate rotation and lever arm, so both are fixed; an actual "
    "lever arm then changes the offset by some milliseconds"
)


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """A fit with the observability of its directions."""

    fit: Fit  # the fit
    directions: dict[str, Directions]  # the directions of every parameter, fitted or not
    free: dict[str, Floats]  # the free directions of every fitted parameter, as rows
    left_out: str  # A sentence about parameters that are not fitted; empty if there are none


def solve(increments: Increments, gauge: Gauge, with_skew: bool) -> CalibrationFit | None:
    """Fit all observable parameters; None if even the offset has no standard deviation."""
    if len(increments) < _FEWEST_PAIRS:
        return None
    about_z = not gauge.has_so3
    begin = increments.start(0.0, with_scale=gauge.has_scale, about_z=about_z)
    free = {"offset": np.eye(1), "rotation": np.eye(3)}
    if about_z and not increments.has_rotations:
        free["rotation"] = np.eye(3)[2:]
    if increments.has_lever:
        free["lever"] = np.eye(3)
    if gauge.has_scale:
        free["scale"] = np.eye(1)
    # The rotation between the worlds is no property of the body and is always fitted.
    body = {"rotation", "lever"} if increments.has_rotations else {"lever"}
    held = {name: axes for name, axes in free.items() if name not in body}
    attempts = [(free, ""), (held, _NO_BODY)]
    if with_skew:
        attempts = [({**free, "skew": np.eye(1)}, ""), (free, _NO_SKEW), (held, _NO_BODY)]
    for chosen, left_out in attempts:
        solution = _settle(increments, begin, chosen)
        if solution is not None:
            return dataclasses.replace(solution, left_out=left_out)
    return None


def _settle(
    increments: Increments, begin: Unknowns, free: dict[str, Floats]
) -> CalibrationFit | None:
    """Fit, fix the unobservable directions, and repeat from the start."""
    hidden: dict[str, Directions] = {}
    solution = None
    while free:
        lever = free.get("lever", np.zeros((0, 3)))
        start = dataclasses.replace(begin, lever_m=lever.T @ (lever @ begin.lever_m))
        fitted = fit(increments, start, basis_of(free))
        if fitted is None:
            return solution
        observable = observability(increments, fitted)
        solution = CalibrationFit(fitted, {**observable, **hidden}, free, "")
        worse = {
            name: directions
            for name, directions in observable.items()
            if name in free and name not in hidden and not directions.seen.all()
        }
        if not worse:
            return solution
        hidden |= worse
        solution = CalibrationFit(fitted, {**observable, **hidden}, free, "")
        free = {
            name: worse[name].directions[worse[name].seen] if name in worse else axes
            for name, axes in free.items()
        }
        free = {name: axes for name, axes in free.items() if len(axes)}
    return solution


def basis_of(free: dict[str, Floats]) -> Floats:
    """Return the free directions as columns (9, P)."""
    basis = np.zeros((COLUMNS, sum(len(axes) for axes in free.values())))
    column = 0
    for name, axes in free.items():
        basis[COLUMNS_OF[name], column : column + len(axes)] = axes.T
        column += len(axes)
    return basis
