"""The causes of errors of a groundtruth, with a verdict and a sentence per cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.groundtruth_quality.joint_fit import HorizonFit
from trajeval_ros.calibration.groundtruth_quality.rig import BODY, GRAVITY, LEVER, UNITS
from trajeval_ros.calibration.groundtruth_quality.sample_checks import (
    PoseChecks,
    PoseSpan,
    ResidualChecks,
)  # fmt: skip
from trajeval_ros.calibration.robust_fit import BLOCKS
from trajeval_ros.calibration.significance import (
    CHANCE,
    INSIGNIFICANT,
    SIGNIFICANT,
    UNOBSERVABLE,
    chance_of,
)  # fmt: skip
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.events import Event

INCONCLUSIVE = "inconclusive"
# Half width of a 95 % interval in standard deviations: Student's t with 11 degrees of freedom.
HALF_WIDTH = 2.201
_Row = tuple[str, float, str, float, str]  # name, value, unit, largest usual value, sentence
_IF_IMU = "; if it is meant to be the IMU's, it is wrong."


@dataclass(frozen=True)
class _Parameter:
    """Columns of a cause in the calibration, its unit, the sizes that count, and its sentence."""

    columns: slice
    unit: str
    least: float  # smaller effects are not reported
    limit: float  # largest useful half width of a 95 % interval
    sentence: str


PARAMETERS = {
    "body_rotation": _Parameter(
        BODY, "deg", 0.2, 2.0, "The groundtruth's orientation is rotated by {size:.2f} deg "
        "({width} deg at 95 %) against the IMU" + _IF_IMU,
    ),
    "lever_arm": _Parameter(
        LEVER, "mm", 3.0, 50.0,
        "The groundtruth refers to a point {size:.1f} mm ({width} mm at 95 %) from the IMU"
        + _IF_IMU,
    ),
    "clock_offset": _Parameter(
        slice(6, 7), "ms", 2.0, 10.0,
        "The groundtruth's timestamps are {size:.1f} ms ({width} ms at 95 %) {change} "
        "{size:.1f} ms.",
    ),
    "clock_skew": _Parameter(
        slice(7, 8), "ppm", 50.0, 500.0, "The groundtruth's clock drifts by {size:.0f} ppm "
        "({width} ppm at 95 %), {per_hour:.2f} s per hour.",
    ),
    "tilted": _Parameter(
        GRAVITY, "deg", 0.3, 2.0, "The groundtruth's z axis is tilted by {size:.2f} deg "
        "({width} deg at 95 %) against gravity.",
    ),
}  # fmt: skip
# Noun, kinds of events and advice by cause, of poses without an IMU.
_DROP = "; evaluate with --drop-groundtruth-outliers"
_EVENTS = {
    "steps": ("step", (kinds.STEP, kinds.LOST), ""),
    "outliers": ("outlier", (kinds.OUTLIER,), _DROP),
    "flips": ("flip", (kinds.FLIP,), _DROP),
    "lasting_flips": ("flip that stays", (kinds.FLIP_STAYS,), ""),
    "clock_steps": ("clock step", (kinds.CLOCK_STEP,), "; evaluate with --correct clock_step"),
}
_MISSING, _HELD, _OUTLIERS, _UNEVEN = 1.0, 2.0, 0.5, 10.0  # %
_JITTER_MS, _JITTER_SIGMAS = 0.2, 4.0


@dataclass(frozen=True)
class GroundtruthCause:
    """A cause of errors, and whether the recording shows it; causes that are counted have no p."""

    name: str  # in tables and JSON
    verdict: str  # `significant`, `insignificant`, `inconclusive` or `unobservable`
    value: float | None = None  # its size in `unit`; None if unknown
    unit: str = ""
    standard_deviation: float | None = None  # of the value
    p_value: float | None = None  # of the hypothesis that the cause is absent
    components: tuple[float, ...] = ()  # of the value, about or along x, y, z
    sentence: str = ""  # the finding, for a significant cause

    @property
    def half_width(self) -> float | None:
        """Half width of the 95 % interval, in `unit`."""
        sigma = self.standard_deviation
        return None if sigma is None else HALF_WIDTH * sigma


# Verdicts that positions alone do not allow.
OF_ROTATION = [
    GroundtruthCause(name, UNOBSERVABLE) for name in ("body_rotation", "fused", "rotation_jumps")
]


def parameter_causes(result: HorizonFit, observable: Booleans) -> Iterator[GroundtruthCause]:
    """Yield the verdicts on the calibration; `observable` (10,) has what is estimated."""
    for name, parameter in PARAMETERS.items():
        value, sigma = result.values[parameter.columns], result.sigmas[parameter.columns]
        if not observable[parameter.columns].any():
            yield GroundtruthCause(name, INCONCLUSIVE, unit=parameter.unit)
            continue
        fixed = result.fixed_axes if name == "lever_arm" else ""
        chance = chance_of(value, np.diag(sigma**2), BLOCKS)
        size = float(np.linalg.norm(value))
        along = float(sigma.max()) if size == 0.0 else float(np.linalg.norm(value * sigma)) / size
        verdict, sentence = INSIGNIFICANT, ""
        if chance < CHANCE and size > parameter.least:
            verdict = SIGNIFICANT
            sentence = parameter.sentence.format(
                size=size,
                width=f"± {HALF_WIDTH * along:.2g}",
                change="early: add" if value[0] > 0.0 else "late: subtract",
                per_hour=size * 3.6e-3,
            )
            if fixed:
                sentence += f" Its component along {fixed} is not observable and assumed zero."
        elif HALF_WIDTH * float(sigma.max()) > parameter.limit or fixed:
            verdict = INCONCLUSIVE
        components, unit = tuple(value.tolist()), parameter.unit
        yield GroundtruthCause(name, verdict, size, unit, along, chance, components, sentence)


def fused_cause(short: HorizonFit, long: HorizonFit, *, disagree: bool) -> GroundtruthCause:
    """Return the verdict on a fusion with an IMU under a wrong body, from two horizons."""
    short_deg, long_deg = (float(np.linalg.norm(item.values[BODY])) for item in (short, long))
    sigma_deg = float(np.degrees(np.linalg.norm(long.noise[3:])))
    sentence = (
        f"The body rotations over 0.1 s and over 2 s disagree ({short_deg:.1f} and {long_deg:.1f} "
        "deg): the groundtruth was fused with an IMU under a wrong body transform. Between poses, "
        f"its orientation is uncertain by {sigma_deg:.2g} deg."
    )
    return _cause("fused", abs(long_deg - short_deg), "deg", sentence, significant=disagree)


def sample_causes(
    poses: PoseChecks, residuals: ResidualChecks | None, origin: int
) -> list[GroundtruthCause]:
    """Return the verdicts on single poses; times count from `origin`, a timestamp in ns."""
    rows = [] if residuals is None else list(_of_residuals(residuals, origin))
    uneven = 100.0 * poses.interval_sigma_s * poses.rate_hz
    missing, held = 100.0 * poses.missing_share, 100.0 * poses.held_share
    repeated = poses.repeated_stamps
    rows += [
        ("gaps", len(poses.gaps), "", 0.0, longest_of(poses.gaps, "gap", origin)),
        ("missing", missing, "%", _MISSING,
            f"{missing:.1f} % of the poses are missing at a rate of {poses.rate_hz:.0f} Hz."),
        ("held", held, "%", _HELD, f"{held:.1f} % of the poses in motion repeat the pose before."),
        ("frozen", len(poses.frozen), "", 0.0,
            f"The pose is frozen {longest_of(poses.frozen, 'time', origin)}"),
        ("repeated_timestamps", repeated, "", 0.0,
            f"{counted(repeated, 'timestamp')} repeated or stepping back."),
        ("uneven_timestamps", uneven, "%", _UNEVEN,
            f"The intervals between timestamps vary by {1e3 * poses.interval_sigma_s:.2f} ms, "
            f"{uneven:.0f} % of their length."),
    ]  # fmt: skip
    return [
        _cause(name, value, unit, sentence, significant=value > limit)
        for name, value, unit, limit, sentence in rows
    ]


def discontinuity_causes(events: Sequence[Event], origin: int) -> Iterator[GroundtruthCause]:
    """Yield the verdicts on steps of the poses and the clock; times count from `origin`, ns."""
    for name, (noun, of_kinds, advice) in _EVENTS.items():
        group = [event for event in events if event.kind in of_kinds]
        largest = max(group, key=lambda event: (event.ratio, abs(event.s)), default=None)
        sentence = ""
        if largest is not None:
            size = f"{largest.s:+.3f} s" if name == "clock_steps" else largest.size
            which = "" if len(group) == 1 else "; the largest is"
            sentence = (
                f"{counted(len(group), noun)} of {'up to ' * (len(group) > 1)}"
                f"{size}{which} at {(largest.t_ns - origin) / 1e9:.2f} s{advice}."
            )
        yield _cause(name, len(group), "", sentence, significant=bool(group))


def _of_residuals(checks: ResidualChecks, origin: int) -> Iterator[_Row]:
    for kind, factor, unit in (("position", 1e3, ".0f} mm"), ("rotation", UNITS[0], ".2f} deg")):
        jumps = [jump for jump in checks.jumps if jump.kind == kind]
        sentence = ""
        if jumps:
            largest = max(jumps, key=lambda jump: jump.size)
            size = ("{:" + unit).format(factor * largest.size)
            second = (largest.stamp_ns - origin) / 1e9
            sentence = f"{counted(len(jumps), f'{kind} jump')} of up to {size}; "
            sentence += f"the largest is at {second:.2f} s. One that lasts also moves the repair."
        yield f"{kind}_jumps", len(jumps), "", 0.0, sentence
    jitter_ms = 1e3 * checks.jitter_s if checks.jitter_sigmas > _JITTER_SIGMAS else 0.0
    sentence = f"Timestamps have random errors of {jitter_ms:.1f} ms."
    yield "jitter", jitter_ms, "ms", _JITTER_MS, sentence
    outliers = 100.0 * checks.outlier_share
    sentence = f"{outliers:.1f} % of the poses are outliers; they were not used."
    yield "outliers", outliers, "%", _OUTLIERS, sentence


def longest_of(spans: Sequence[PoseSpan], what: str, origin: int) -> str:
    """Return the number of spans and the longest one; `what` is one span, `origin` in ns."""
    longest = max(spans, key=lambda span: span.duration_s, default=PoseSpan(origin, 0.0))
    second = (longest.start_ns - origin) / 1e9
    number = counted(len(spans), what)
    return f"{number}; the longest is {longest.duration_s:.2f} s at {second:.2f} s."


def _cause(
    name: str, value: float, unit: str, sentence: str, *, significant: bool
) -> GroundtruthCause:
    verdict = SIGNIFICANT if significant else INSIGNIFICANT
    return GroundtruthCause(name, verdict, float(value), unit, sentence=sentence * significant)
