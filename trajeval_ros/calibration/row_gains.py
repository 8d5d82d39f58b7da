"""Whether rotations and positions both support a body rotation that the fit found.

A body that turns about one axis alone doesn't show a rotation about that axis by its rotations:
positions alone do, and there a drift of attitude that positions don't share looks the same. An
estimate with mirrored axes is the other way round: a rotation explains its rotations and makes its
positions worse. Each kind of rows is therefore asked what the rotation gains it, by Huber's cost
rho of its residuals in the best fits without and with the rotation:

    gain = 1 - sum rho(with) / sum rho(without)

On simulated flights with right bodies, gains of rotation rows are below 0.01 wherever the fit
finds a rotation; with a rotation of 3 deg or more they are above 0.12, unless it is about the only
axis. Mirrored axes cost the positions a gain below -3, real rotations at most -0.2.
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
    """The share of the cost that a body rotation takes from each kind of rows; below 0 it adds."""

    rotation: float
    position: float


def row_gains(increments: Increments, solution: CalibrationFit) -> RowGains | None:
    """Return the gains of the rotation of a solution, fitted with rotations on both sides.

    None if there is no fit without the rotation.
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
    """Return the verdict on a body rotation, `insignificant` if one kind of rows contradicts it.

    Args:
        turn: The verdict by all rows together.
        increments: What it was fitted to.
        solution: The fit.
        systematic_rad: Standard deviation of what no run shows of itself.
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
    """Return how often chance gives the rotation that rotation rows alone tell.

    Along the directions that they show: about others their noise looks like a rotation.
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
