"""Test of an estimated body rotation against rotations and positions separately.

If the body rotates about one axis only, its rotations do not determine a rotation about that axis.
Positions do, but attitude drift has the same effect on them. Mirrored axes have the opposite
effect: a rotation reduces the rotation residuals and increases the position residuals. Therefore
the gain of the rotation is computed for both groups of rows, with Huber's cost rho of the
residuals in the best fits without and with the rotation:

    gain = 1 - sum rho(with) / sum rho(without)

On simulated flights with correct bodies, gains of rotation rows are below 0.01 whenever the fit
has a rotation. With a true rotation of at least 3 deg they are above 0.12, unless it is about the
only axis. Mirrored axes have position gains below -3, true rotations at least -0.2.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.increments import POSITION, ROTATION, TURN, Increments
from trajeval_ros.calibration.observability import observability
from trajeval_ros.calibration.robust_fit import fit, huber_cost
from trajeval_ros.calibration.significance import CHANCE, INSIGNIFICANT, Parameter, chance_of
from trajeval_ros.calibration.solve import CalibrationFit, basis_of
from trajeval_ros.geometry import so3

LEAST_OF_ROTATIONS = 0.02
LEAST_OF_POSITIONS = -0.5
POSITIONS_ALONE = (
    "only positions support it and rotations do not, as with attitude drift; if the transform "
    "is known, give --hand-eye FILE"
)
POSITIONS_WORSE = (
    "it reduces the rotation error and increases the position error; check for mirrored axes"
)


@dataclass(frozen=True)
class RowGains:
    """Relative reduction (negative: increase) of the cost by a body rotation, by group of rows."""

    rotation: float
    position: float


def row_gains(increments: Increments, solution: CalibrationFit) -> RowGains | None:
    """Return the gains of a solution's rotation, for orientations on both sides.

    None if the fit without the rotation fails.
    """
    rest = {name: axes for name, axes in solution.free.items() if name != "turn"}
    none = dataclasses.replace(solution.fit.unknowns, turn=np.eye(3))
    without = fit(increments, none, basis_of(rest))
    if without is None:
        return None

    def gain(kind: slice) -> float:
        before, after = without.linearised.residual, solution.fit.linearised.residual
        return 1.0 - huber_cost(after, after, kind) / huber_cost(before, after, kind)

    return RowGains(gain(ROTATION), gain(POSITION))


def supported_by_both(
    turn: Parameter, increments: Increments, solution: CalibrationFit, systematic_rad: float
) -> Parameter:
    """Return the verdict on a body rotation: `insignificant` if one group of rows contradicts it.

    Args:
        turn: The verdict from all rows together.
        increments: The data.
        solution: The fit.
        systematic_rad: Standard deviation of systematic errors, rad.
    """
    if not turn.is_significant:
        return turn
    gains = row_gains(increments, solution)
    if gains is None:
        return turn
    if gains.position <= LEAST_OF_POSITIONS:
        return dataclasses.replace(turn, status=INSIGNIFICANT, reason=POSITIONS_WORSE)
    if gains.rotation > LEAST_OF_ROTATIONS:
        return turn
    if _by_rotations_alone(increments, solution, systematic_rad) < CHANCE:
        return turn
    return dataclasses.replace(turn, status=INSIGNIFICANT, reason=POSITIONS_ALONE)


def _by_rotations_alone(
    increments: Increments, solution: CalibrationFit, systematic_rad: float
) -> float:
    """Return the p-value of the rotation from rotation rows alone.

    Only observable directions are tested; noise along the others looks like a rotation.
    """
    basis = basis_of({"turn": np.eye(3)})
    alone = fit(increments, solution.fit.unknowns, basis, (ROTATION,))
    if alone is None:
        return 1.0
    value = so3.log(alone.unknowns.turn[None])[0]
    covariance = alone.covariance[TURN, TURN] + systematic_rad**2 * np.eye(3)
    shown = observability(increments, alone)["turn"]
    axes = shown.directions[shown.seen]
    if not len(axes):
        return 1.0
    return chance_of(axes @ value, axes @ covariance @ axes.T, alone.blocks)
