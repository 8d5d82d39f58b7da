"""The causes of errors of a groundtruth, with a verdict and a sentence per cause."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor.rig import BODY, GRAVITY, LEVER
from trajeval_ros.calibration.groundtruth_doctor.sample_checks import PoseChecks, ResidualChecks
from trajeval_ros.calibration.robust_fit import BLOCKS
from trajeval_ros.calibration.significance import (
    CHANCE,
    INSIGNIFICANT,
    SIGNIFICANT,
    chance_of,
)  # fmt: skip
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans, Floats

INCONCLUSIVE = "inconclusive"
# Half width of a 95 % interval in standard deviations: Student's t with 11 degrees of freedom.
HALF_WIDTH = 2.201
# Units of the calibration's ten parameters: deg, mm, ms, ppm, deg.
UNITS = np.array([180.0 / math.pi] * 3 + [1e3] * 4 + [1e6] + [180.0 / math.pi] * 2)


@dataclass(frozen=True)
class _Parameter:
    """Columns of a cause in the calibration, its unit, and the sizes that count."""

    columns: slice
    unit: str
    least: float  # smaller effects are not reported
    limit: float  # largest useful half width of a 95 % interval


PARAMETERS = {
    "body_rotation": _Parameter(BODY, "deg", 0.2, 2.0),
    "lever_arm": _Parameter(LEVER, "mm", 3.0, 50.0),
    "clock_offset": _Parameter(slice(6, 7), "ms", 2.0, 10.0),
    "clock_skew": _Parameter(slice(7, 8), "ppm", 50.0, 500.0),
    "tilted": _Parameter(GRAVITY, "deg", 0.3, 2.0),
}
_MISSING, _HELD, _OUTLIERS, _UNEVEN = 0.01, 0.02, 0.005, 0.1
_JITTER_S, _JITTER_SIGMAS = 2e-4, 4.0
SMOOTH_M = 2e-5  # a smaller high-frequency noise is that of a model


@dataclass(frozen=True)
class GroundtruthCause:
    """A cause of errors, and whether the recording shows it.

    Attributes:
        name: Its name in tables and JSON.
        verdict: `significant`, `insignificant` or `inconclusive`.
        value: Its size in `unit`; None if unknown.
        unit: Unit of the value.
        standard_deviation: Of the value, in `unit`; None for causes that are counted.
        p_value: Of the hypothesis that the cause is absent; None for causes that are counted.
        components: Components of the value about or along x, y, z.
        sentence: The finding, for a significant cause.
    """

    name: str
    verdict: str
    value: float | None = None
    unit: str = ""
    standard_deviation: float | None = None
    p_value: float | None = None
    components: tuple[float, ...] = ()
    sentence: str = ""

    @property
    def half_width(self) -> float | None:
        """Half width of the 95 % interval, in `unit`."""
        sigma = self.standard_deviation
        return None if sigma is None else HALF_WIDTH * sigma


def parameter_cause(
    name: str, values: Floats, sigmas: Floats, *, observable: Booleans, axes: str = ""
) -> GroundtruthCause:
    """Return the verdict on parameters of the calibration.

    Args:
        name: Key of `PARAMETERS`.
        values: The calibration (10,), in `UNITS`.
        sigmas: Standard deviations (10,), in `UNITS`.
        observable: The parameters (10,) that are estimated.
        axes: Directions that are fixed at zero, for the sentence.
    """
    parameter = PARAMETERS[name]
    value, sigma = values[parameter.columns], sigmas[parameter.columns]
    if not observable[parameter.columns].any():
        return GroundtruthCause(name, INCONCLUSIVE, unit=parameter.unit)
    chance = chance_of(value, np.diag(sigma**2), BLOCKS)
    size = float(np.linalg.norm(value))
    along = float(sigma.max()) if size == 0.0 else float(np.linalg.norm(value * sigma)) / size
    verdict = INSIGNIFICANT
    if chance < CHANCE and size > parameter.least:
        verdict = SIGNIFICANT
    elif HALF_WIDTH * float(sigma.max()) > parameter.limit or axes:
        verdict = INCONCLUSIVE
    sentence = ""
    if verdict == SIGNIFICANT:
        signed = float(value[0]) if len(value) == 1 else size
        sentence = _sentence(name, signed, HALF_WIDTH * along)
        if axes:
            sentence += f" Its component along {axes} is not observable and assumed zero."
    components = tuple(value.tolist())
    return GroundtruthCause(
        name, verdict, size, parameter.unit, along, chance, components, sentence
    )


def _sentence(name: str, value: float, half_width: float) -> str:
    width = f"± {half_width:.2g}"
    if name == "body_rotation":
        return (
            f"The groundtruth's orientation is rotated by {value:.2f} deg ({width} deg at 95 %) "
            "against the IMU; if it is meant to be the IMU's, it is wrong."
        )
    if name == "lever_arm":
        return (
            f"The groundtruth refers to a point {value:.1f} mm ({width} mm at 95 %) from the IMU; "
            "if it is meant to be the IMU's, it is wrong."
        )
    if name == "clock_offset":
        way, change = ("early", "add") if value > 0.0 else ("late", "subtract")
        return (
            f"The groundtruth's timestamps are {abs(value):.1f} ms ({width} ms at 95 %) {way}: "
            f"{change} {abs(value):.1f} ms."
        )
    if name == "clock_skew":
        return (
            f"The groundtruth's clock drifts by {abs(value):.0f} ppm ({width} ppm at 95 %), "
            f"{abs(value) * 3.6e-3:.2f} s per hour."
        )
    return (
        f"The groundtruth's z axis is tilted by {value:.2f} deg ({width} deg at 95 %) against "
        "gravity."
    )


def fused_cause(
    short_deg: float, long_deg: float, sigma_deg: float, *, disagree: bool
) -> GroundtruthCause:
    """Return the verdict on a fusion with an IMU under a wrong body, from two horizons."""
    sentence = (
        f"The body rotations over 0.1 s and over 2 s disagree ({short_deg:.1f} and {long_deg:.1f} "
        "deg): the groundtruth was fused with an IMU under a wrong body transform. Between poses, "
        f"its orientation is uncertain by {sigma_deg:.2g} deg."
    )
    verdict = SIGNIFICANT if disagree else INSIGNIFICANT
    return GroundtruthCause(
        "fused", verdict, abs(long_deg - short_deg), "deg", sentence=sentence * disagree
    )


def pose_causes(checks: PoseChecks, origin: int) -> list[GroundtruthCause]:
    """Return the verdicts on the poses alone; times count from `origin`, a timestamp in ns."""
    gap = max(checks.gaps, key=lambda each: each.duration_s, default=None)
    frozen = max(checks.frozen, key=lambda each: each.duration_s, default=None)
    uneven = checks.interval_sigma_s * checks.rate_hz
    return [
        _counted(
            "gaps", len(checks.gaps), "", 0.0, "" if gap is None else
            f"{counted(len(checks.gaps), 'gap')}; the longest of {gap.duration_s:.2f} s is at "
            f"{(gap.start_ns - origin) / 1e9:.2f} s.",
        ),
        _counted(
            "missing", 100.0 * checks.missing_share, "%", 100.0 * _MISSING,
            f"{100.0 * checks.missing_share:.1f} % of the poses are missing at a rate of "
            f"{checks.rate_hz:.0f} Hz.",
        ),
        _counted(
            "held", 100.0 * checks.held_share, "%", 100.0 * _HELD,
            f"{100.0 * checks.held_share:.1f} % of the poses in motion repeat the pose before.",
        ),
        _counted(
            "frozen", len(checks.frozen), "", 0.0, "" if frozen is None else
            f"The pose is frozen {counted(len(checks.frozen), 'time')}; the longest is "
            f"{frozen.duration_s:.2f} s at {(frozen.start_ns - origin) / 1e9:.2f} s.",
        ),
        _counted(
            "repeated_timestamps", checks.repeated_stamps, "", 0.0,
            f"{counted(checks.repeated_stamps, 'timestamp')} repeated or stepping back.",
        ),
        _counted(
            "uneven_timestamps", 100.0 * uneven, "%", 100.0 * _UNEVEN,
            f"The intervals between timestamps vary by {1e3 * checks.interval_sigma_s:.2f} ms, "
            f"{100.0 * uneven:.0f} % of their length.",
        ),
    ]  # fmt: skip


def residual_causes(checks: ResidualChecks, origin: int) -> list[GroundtruthCause]:
    """Return the verdicts from the residuals; times count from `origin`, a timestamp in ns."""
    jittered = checks.jitter_s if checks.jitter_sigmas > _JITTER_SIGMAS else 0.0
    return [
        *(_jumps(kind, checks, origin) for kind in ("position", "rotation")),
        _counted(
            "jitter", 1e3 * jittered, "ms", 1e3 * _JITTER_S,
            f"Timestamps have random errors of {1e3 * jittered:.1f} ms.",
        ),
        _counted(
            "outliers", 100.0 * checks.outlier_share, "%", 100.0 * _OUTLIERS,
            f"{100.0 * checks.outlier_share:.1f} % of the poses are outliers; they were not used.",
        ),
    ]  # fmt: skip


def _jumps(kind: str, checks: ResidualChecks, origin: int) -> GroundtruthCause:
    jumps = [each for each in checks.jumps if each.kind == kind]
    name = f"{kind}_jumps"
    if not jumps:
        return GroundtruthCause(name, INSIGNIFICANT, 0.0)
    largest = max(jumps, key=lambda each: each.size)
    size = f"{1e3 * largest.size:.0f} mm"
    if kind == "rotation":
        size = f"{math.degrees(largest.size):.2f} deg"
    sentence = (
        f"{counted(len(jumps), f'{kind} jump')} of up to {size}; the largest is at "
        f"{(largest.stamp_ns - origin) / 1e9:.2f} s."
    )
    return GroundtruthCause(name, SIGNIFICANT, float(len(jumps)), sentence=sentence)


def _counted(name: str, value: float, unit: str, limit: float, sentence: str) -> GroundtruthCause:
    found = value > limit
    verdict = SIGNIFICANT if found else INSIGNIFICANT
    return GroundtruthCause(name, verdict, float(value), unit, sentence=sentence * found)
