"""Choice of the fitted directions: all that are observable and have standard deviations."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.increments import (
    COLUMNS,
    LEVER,
    OFFSET,
    SCALE,
    SKEW,
    TURN,
    Increments,
    Unknowns,
)
from trajeval_ros.calibration.observability import Directions, observability
from trajeval_ros.calibration.robust_fit import Fit, fit
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge

_FEWEST_PAIRS = 30
COLUMNS_OF = {"offset": OFFSET, "skew": SKEW, "turn": TURN, "lever": LEVER, "scale": SCALE}
_NO_SKEW = "the run is too short to estimate a clock skew, so none is estimated"
_NO_BODY = (
    "the run is too short to estimate rotation and lever arm, so both are fixed; an actual "
    "lever arm then changes the offset by some milliseconds"
)


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """A fit with the observability of its directions.

    Attributes:
        fit: The fit.
        found: The directions of every parameter, fitted or not.
        free: The free directions of every fitted parameter, as rows.
        left_out: A sentence about parameters that are not fitted; empty if there are none.
    """

    fit: Fit
    found: dict[str, Directions]
    free: dict[str, Floats]
    left_out: str


def solve(increments: Increments, gauge: Gauge, with_skew: bool) -> CalibrationFit | None:
    """Fit all observable parameters; None if even the offset has no standard deviation."""
    if len(increments) < _FEWEST_PAIRS:
        return None
    about_z = not gauge.turns_freely
    begin = increments.start(0.0, with_scale=gauge.has_scale, about_z=about_z)
    free = {"offset": np.eye(1), "turn": np.eye(3)}
    if about_z and not increments.has_turns:
        free["turn"] = np.eye(3)[2:]
    if increments.turned is not None:
        free["lever"] = np.eye(3)
    if gauge.has_scale:
        free["scale"] = np.eye(1)
    # The rotation between the worlds is no property of the body and is always fitted.
    body = {"turn", "lever"} if increments.has_turns else {"lever"}
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
        found = observability(increments, fitted)
        solution = CalibrationFit(fitted, {**found, **hidden}, free, "")
        worse = {
            name: directions
            for name, directions in found.items()
            if name in free and name not in hidden and not directions.seen.all()
        }
        if not worse:
            return solution
        hidden |= worse
        solution = CalibrationFit(fitted, {**found, **hidden}, free, "")
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
