"""The calibration of an estimate against groundtruth: clock offset, body rotation, lever arm.

It is estimated from relative motions, not by minimising the ATE. Therefore a comparison of the ATE
before and after is an independent check.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.clock_offset import OVERLAP_S, SEARCH_S, OffsetGuess, guess_offset
from trajeval_ros.calibration.increments import (
    MOST_INCREMENTS,
    POSITION,
    ROTATION,
    Increments,
    whole_nanoseconds,
)
from trajeval_ros.calibration.observability import (
    COLUMNS_OF,
    CalibrationFit,
    basis_of,
    observability,
    solve,
)
from trajeval_ros.calibration.robust_fit import Fit, fit
from trajeval_ros.calibration.significance import (
    CHANCE,
    CHANCE_OF_SKEW,
    Parameter,
    judge,
    supported_by_both,
    unobservable,
)
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.frame_axes import upright
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

# Largest useful half width of a 95 % interval: s, s/s, rad, m.
WIDEST = {"offset": 0.010, "skew": 100e-6, "rotation": np.radians(2.0), "lever": 0.1}
_SHORT_RUN_S = 60.0
_SHORT_FOR_SKEW_S = 120.0


@dataclass(frozen=True)
class SystematicErrors:
    """Standard deviations of errors that one run does not reveal; 0 for simulated data."""

    offset_s: float = 1.5e-3  # of the offset, s; doubled for runs shorter than a minute
    rotation_rad: float = float(np.radians(0.1))  # of the body's rotation, rad


# Least standard deviations, for inputs without noise: s, s/s, rad, m.
_FLOORS = {"offset": 1e-5, "skew": 1e-7, "rotation": 1e-5, "lever": 1e-5}


@dataclass(frozen=True, eq=False)
class Calibration:
    """Estimated clock and body parameters.

    Attributes:
        offset: Offset to add to the estimate's timestamps at the middle of the run, s.
        skew: Relative drift of the clocks, s/s; None if not requested.
        rotation: R_X, rotation from the marker's axes to the body's, as a rotation vector, rad.
        lever: p_B_M, position of the marker in the body, metres.
        scale: Groundtruth metres per unit of the estimate; 1 unless the gauge has a scale.
        guess: The initial offset, from correlation.
        rows: Offset and its standard deviation from rotations alone and from positions alone, if
            observable.
        fitted: Number of fitted parameters.
        blocks: Number of time blocks for the standard deviations.
        pairs: Number of increments.
        horizon_s: Duration of the increments.
        remarks: Warnings about it.

    Example:
        >>> from trajeval_ros import calibrate, simulate
        >>> flight = simulate(seed=1, duration_s=60.0)
        >>> calibrate(flight.groundtruth, flight.estimate).skew is None
        True
    """

    offset: Parameter
    skew: Parameter | None
    rotation: Parameter
    lever: Parameter
    scale: float
    guess: OffsetGuess
    rows: dict[str, tuple[float, float]]
    fitted: int
    blocks: int
    pairs: int
    horizon_s: float
    remarks: tuple[Remark, ...] = ()


def calibrate(
    groundtruth: Trajectory,
    estimate: Trajectory,
    gauge: Gauge | str = Gauge.SE3,
    *,
    around_s: float = 0.0,
    with_skew: bool = False,
    systematic: SystematicErrors | None = None,
    most_increments: int = MOST_INCREMENTS,
) -> Calibration:
    """Estimate clock offset, body rotation and lever arm from increments.

    All parameters are always estimated together. Without an actual lever arm in the model the
    offset would be wrong by up to 16 ms.

    Args:
        groundtruth: T_G_M, poses or positions of the marker.
        estimate: T_W_B, poses or positions of the body.
        gauge: Determines whether a scale is estimated and whether both worlds share gravity.
        around_s: Centre of the search for the offset, s, which extends to +-`SEARCH_S`. If the
            trajectories do not overlap within this range, all offsets are searched (clocks of
            different epochs).
        with_skew: Whether to estimate the clocks' skew.
        systematic: Standard deviations of systematic errors; None for the default.
        most_increments: Largest number of increments.

    Raises:
        InputError: A trajectory has no timestamps, or too few states.

    Example:
        >>> from dataclasses import replace
        >>> from trajeval_ros import calibrate, simulate
        >>> flight = simulate(seed=1, duration_s=60.0)
        >>> late = replace(flight.estimate, stamps=flight.estimate.stamps + 100_000_000)
        >>> result = calibrate(flight.groundtruth, late, "yaw")
        >>> result.offset.status, round(float(result.offset.value[0]), 1)
        ('significant', -0.1)
    """
    gauge = Gauge.of(gauge)
    if gauge.yaw_only:
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    for name, side in (("groundtruth", groundtruth), ("estimate", estimate)):
        if not side.reading.stamped:
            raise InputError(
                f"{side.name or name} has no timestamps, which a calibration needs; set the rate "
                "of its frames with --frame-rate"
            )
        if len(side.in_order()) < 2:
            raise InputError(f"{side.name or name} has fewer than two poses")
    can_meet = _apart(groundtruth, estimate, around_s) <= SEARCH_S - OVERLAP_S
    search_s = SEARCH_S if can_meet else None
    guess = guess_offset(groundtruth, estimate, around_s=around_s, search_s=search_s)
    # Whole nanoseconds are added first, so that offsets of decades do not cost precision.
    base = whole_nanoseconds(guess.offset_s if guess.is_usable else around_s)
    shifted = dataclasses.replace(estimate, stamps=estimate.stamps + base)
    increments = Increments(groundtruth, shifted, most_increments)
    solution = solve(increments, gauge, with_skew)
    if solution is None:
        return _without(guess, increments, with_skew)
    return _judged(solution, increments, guess, base, systematic or SystematicErrors(), with_skew)


def _apart(groundtruth: Trajectory, estimate: Trajectory, around_s: float) -> float:
    """Return the time between the trajectories, s; negative if they overlap."""
    shift = whole_nanoseconds(around_s)
    first, last = int(estimate.stamps.min()) + shift, int(estimate.stamps.max()) + shift
    before = first - int(groundtruth.stamps.max())
    after = int(groundtruth.stamps.min()) - last
    return max(before, after) / NANOSECONDS


def _judged(
    solution: CalibrationFit,
    increments: Increments,
    guess: OffsetGuess,
    base: int,
    systematic: SystematicErrors,
    with_skew: bool,
) -> Calibration:
    """Return the calibration with the status of every parameter."""
    fitted, observable = solution.fit, solution.directions
    duration_s = float(np.ptp(fitted.linearised.seconds))
    left_out = solution.left_out
    warnings = [warning("parameters_left_out", left_out)] if left_out else []
    if not fitted.settled and any(directions.seen.any() for directions in observable.values()):
        warnings.append(
            warning(
                "calibration_not_converged",
                "the calibration did not converge; its values are approximate",
            )
        )
    rows, apart_s = _by_rows(increments, fitted, base)
    hidden_s = systematic.offset_s * (2.0 if duration_s < _SHORT_RUN_S else 1.0)
    if with_skew and duration_s < _SHORT_FOR_SKEW_S:
        warnings.append(
            warning(
                "short_for_clock_skew",
                f"the clock skew from {duration_s:.0f} s is unreliable; use at least "
                f"{_SHORT_FOR_SKEW_S:g} s",
            )
        )
    extra = {"offset": np.hypot(hidden_s, apart_s / 2.0), "rotation": systematic.rotation_rad}
    values = {
        "offset": np.array([base / NANOSECONDS + fitted.unknowns.offset_s]),
        "skew": np.array([fitted.unknowns.skew]),
        "rotation": so3.log(fitted.unknowns.rotation[None])[0],
        "lever": fitted.unknowns.lever_m,
    }

    def verdict(name: str, unit: str) -> Parameter:
        columns = COLUMNS_OF[name]
        covariance = fitted.covariance[columns, columns]
        if name not in observable or (
            observable[name].seen.any() and not np.diag(covariance).any()
        ):
            return unobservable(_TOO_SHORT)
        return judge(
            values[name],
            covariance + _FLOORS[name] ** 2 * np.eye(len(covariance)),
            extra.get(name, 0.0),
            observable[name],
            fitted.blocks,
            widest=WIDEST[name],
            unit=unit,
            chance=CHANCE_OF_SKEW if name == "skew" else CHANCE,
            whole=name == "rotation",
        )

    rotation = unobservable(_NO_TURN)
    if increments.has_rotations:
        rotation = supported_by_both(
            verdict("rotation", "rad"), increments, solution, systematic.rotation_rad
        )
    offset = verdict("offset", "s")
    if not guess.is_usable:
        offset = unobservable(guess.problem, offset.reliability)
    within_s = 0.0 if offset.half_width_95 is None else float(offset.half_width_95[0])
    if apart_s > within_s:
        warnings.append(
            warning(
                "clocks_of_parts_differ",
                "positions and orientations have different clock offsets: "
                f"{1e3 * rows['rotation'][0]:+.1f} ms from rotations, "
                f"{1e3 * rows['position'][0]:+.1f} ms from positions; half of the difference is "
                "added to the standard deviation",
            )
        )
    return Calibration(
        offset=offset,
        skew=verdict("skew", "s/s") if with_skew else None,
        rotation=rotation,
        lever=verdict("lever", "m") if increments.has_lever else unobservable(_NO_LEVER),
        scale=fitted.unknowns.scale,
        guess=guess,
        rows=rows,
        fitted=fitted.free,
        blocks=fitted.blocks,
        pairs=len(fitted.linearised.rows),
        horizon_s=increments.horizon_s,
        remarks=tuple(warnings),
    )


_TOO_SHORT = "the common time span is too short for a standard deviation"
_NO_TURN = "a rotation between bodies needs orientations on both sides"
_NO_LEVER = "a lever arm needs the estimate's orientations"


def _without(guess: OffsetGuess, increments: Increments, with_skew: bool) -> Calibration:
    """Return the result for a run without observable parameters."""
    nothing = unobservable(guess.problem or _TOO_SHORT)
    return Calibration(
        offset=nothing,
        skew=nothing if with_skew else None,
        rotation=unobservable(_TOO_SHORT) if increments.has_rotations else unobservable(_NO_TURN),
        lever=unobservable(_TOO_SHORT if increments.has_lever else _NO_LEVER),
        scale=1.0,
        guess=guess,
        rows={},
        fitted=0,
        blocks=0,
        pairs=len(increments),
        horizon_s=increments.horizon_s,
    )


def _by_rows(
    increments: Increments, fitted: Fit, base: int
) -> tuple[dict[str, tuple[float, float]], float]:
    """Return offset and standard deviation from rotations and from positions, if observable.

    The second value is the difference of both offsets, s; zero if it is not significant.
    """
    from scipy.special import stdtrit

    rows: dict[str, tuple[float, float]] = {}
    if not increments.has_rotations or not fitted.covariance[0, 0] > 0.0:
        return rows, 0.0
    free = {"offset": np.eye(1), "rotation": np.eye(3)}
    for name, kind, basis in (
        ("rotation", ROTATION, basis_of(free)),
        ("position", POSITION, basis_of({**free, "lever": np.eye(3)})),
    ):
        alone = fit(increments, fitted.unknowns, basis, (kind,))
        if alone is None or not alone.settled:
            continue
        if observability(increments, alone)["offset"].seen.all():
            sigma = float(np.sqrt(alone.covariance[0, 0]))
            rows[name] = (base / NANOSECONDS + alone.unknowns.offset_s, sigma)
    if len(rows) < 2:
        return rows, 0.0
    (rotation, of_rotation), (position, of_position) = rows["rotation"], rows["position"]
    # Without noise, the standard deviations are zero.
    sigma = np.hypot(np.hypot(of_rotation, of_position), _FLOORS["offset"])
    limit = float(stdtrit(fitted.blocks - 1, 1.0 - CHANCE / 2.0)) * sigma
    apart = abs(position - rotation)
    return rows, apart if apart > limit else 0.0
