"""Remarks on errors that were measured with GNSS fixes or surveyed points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.arrays import extents
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.statistics import median
from trajeval_ros.pipeline.input_remarks import about_lever_arm, about_unused_rule

if TYPE_CHECKING:
    from trajeval_ros.geometry.arrays import Floats
    from trajeval_ros.geometry.fixes import Fixes
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.evaluation import Evaluation
    from trajeval_ros.metrics.noise_corrected_ate import NoiseCorrectedAte

# Standard deviations with a larger ratio are of two kinds, such as fixed and float RTK.
_SPAN = 10.0
# Standard deviation of heights, as a fraction of the horizontal extent, that tilts an alignment.
_HEIGHT_SHARE = 0.1
# The tangent plane leaves the ground by d^2 / 2R, 2 m at this distance.
_EXTENT_M = 5000.0
# Geoid and ellipsoid are up to 100 m apart; other steps of heights are smaller.
_GEOID_STEP_M = 8.0
_STEP_FIXES = 10  # on both sides of a step
# The error of linear interpolation that is too much, relative to the ATE.
_INTERPOLATION_SHARE = 0.1


def require_fixes_fit(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], gauge: Gauge, rule: FixRule
) -> None:
    """Refuse a gauge that needs heights, or another frame than that of the fixes."""
    assert groundtruth.reading.fixes is not None
    if not groundtruth.reading.fixes.have_heights and gauge is not Gauge.PLANAR:
        raise InputError("fixes have no height; use --gauge planar")
    alike = all(estimate.reading.fixes is not None for estimate in estimates)
    if gauge is Gauge.NONE and rule.datum is None and not alike:
        raise InputError(
            "gauge none needs a common frame, and the origin of the fixes is arbitrary; give "
            "the origin of the estimate's frame with --datum LAT,LON,HEIGHT, or use --gauge "
            "yaw"
        )


def fix_remarks(
    evaluation: Evaluation,
    rule: FixRule,
    ate: NoiseCorrectedAte | None = None,
    why: str = "",
    *,
    lever_arm_known: bool = False,
    of: int = 1,
) -> list[Remark]:
    """Return remarks on groundtruth of GNSS fixes or points, or on settings of fixes without them.

    `ate` is the error without the noise of the fixes, or None for the reason `why`, and `of` the
    number of evaluated estimates. The point's place may be known (`lever_arm_known`).
    """
    lever_arm = [] if lever_arm_known else about_lever_arm(evaluation)
    if evaluation.groundtruth.reading.fixes is None:
        return [*about_unused_rule(rule), *lever_arm]
    return [*about_fixes(evaluation, ate, why, of), *lever_arm]


def about_fixes(
    evaluation: Evaluation, ate: NoiseCorrectedAte | None, why: str, of: int
) -> Iterator[Remark]:
    """Yield warnings about an evaluation by GNSS fixes, see `fix_remarks`."""
    pairs = evaluation.association
    fixes = pairs.groundtruth.reading.fixes
    if ate is None:
        yield warning(
            "noise_of_fixes_unknown",
            f"the ATE includes the noise of the fixes, which can't be removed: {why}",
        )
    else:
        yield from _about_jumps(ate, of)
    if fixes is not None:
        yield from _about_sigmas(fixes, evaluation)
    yield from _about_heights(evaluation)
    extent_m = float(extents(pairs.groundtruth.positions[:, :2]).max())
    if extent_m > _EXTENT_M and not evaluation.protocol.gauge.has_so3:
        yield warning(
            "curvature_of_the_earth",
            f"the fixes extend over {extent_m / 1e3:.1f} km, where the curvature of the Earth "
            "causes vertical differences of metres",
        )
    yield from _about_interpolation(evaluation)


def _about_jumps(ate: NoiseCorrectedAte, of: int) -> Iterator[Remark]:
    if ate.jumps and of > 1:
        yield warning(
            "fixes_jump",
            f"{counted(ate.jumps, 'fix', 'fixes')} in jumps common to all {of} estimates, caused "
            "by the receiver (multipath): included in the ATE, not in the noise-corrected ATE",
        )
    elif ate.jumps:
        yield warning(
            "fixes_jump",
            f"{counted(ate.jumps, 'fix', 'fixes')} in jumps away from the estimate and back: "
            "included in the ATE, not in the noise-corrected ATE; add a second estimate to "
            "identify the cause",
        )
    if ate.single_jumps:
        yield warning(
            "estimate_jumps",
            f"at {counted(ate.single_jumps, 'fix', 'fixes')} only this estimate jumps, and others "
            "do not: included in its noise-corrected ATE",
        )


def _about_sigmas(fixes: Fixes, evaluation: Evaluation) -> Iterator[Remark]:
    sigma = np.sort(fixes.sigma_level_m[fixes.known])
    if not len(sigma) or sigma[-1] <= _SPAN * sigma[0]:
        return
    if evaluation.protocol.align_weights != "none":
        return
    # What parts them is the widest step between neighbours, in ratio.
    place = int(np.argmax(sigma[1:] / sigma[:-1]))
    limit = float(np.sqrt(sigma[place] * sigma[place + 1]))
    worse, better = median(sigma[place + 1 :]), median(sigma[: place + 1])
    yield warning(
        "mixed_fixes",
        f"{len(sigma) - place - 1} of {len(sigma)} fixes have a standard deviation of "
        f"{worse:.2g} m, the others {better:.2g} m (probably float and fixed RTK); exclude the "
        f"former with --max-fix-sigma {limit:.1g}",
    )


def _about_heights(evaluation: Evaluation) -> Iterator[Remark]:
    pairs, gauge = evaluation.association, evaluation.protocol.gauge
    groundtruth = pairs.groundtruth
    if gauge.has_so3 and groundtruth.reading.fixes is not None:
        rotation = evaluation.alignment.similarity.rotation
        tilt_deg = float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))))
        extent_m = float(extents(groundtruth.positions[:, :2]).max())
        sigma_m = groundtruth.reading.fixes.sigma_up_m
        bad = not np.isfinite(sigma_m).any() or float(np.nanmax(sigma_m)) > (
            _HEIGHT_SHARE * max(extent_m, 1e-9)
        )
        if tilt_deg > 1.0 and (bad or tilt_deg > 5.0):
            yield warning(
                "tilted_by_heights",
                f"gauge {gauge.value} tilts the estimate by {tilt_deg:.1f} deg to fit the "
                "heights of the fixes; for an estimate with known gravity direction, use "
                "--gauge yaw",
            )
    step_m = _height_step(groundtruth.positions[:, 2] - evaluation.aligned.positions[:, 2])
    if step_m is not None and gauge is not Gauge.PLANAR:
        yield warning(
            "heights_jump",
            f"the heights of the fixes change by {step_m:+.1f} m at once, as between ellipsoid "
            "and mean sea level; use --gauge planar, or the horizontal error",
        )


def _height_step(errors: Floats) -> float | None:
    """Return the size of a permanent step of height errors (N,), metres; None without one."""
    if len(errors) < 2 * _STEP_FIXES:
        return None
    steps = np.diff(errors)
    place = int(np.argmax(np.abs(steps)))
    before, after = errors[: place + 1], errors[place + 1 :]
    if min(len(before), len(after)) < _STEP_FIXES or abs(steps[place]) < _GEOID_STEP_M:
        return None
    level = float(median(after[:_STEP_FIXES]) - median(before[-_STEP_FIXES:]))
    rest = median(np.abs(np.delete(steps, place)))
    is_step = abs(level - steps[place]) < 0.2 * abs(level) and abs(level) > _SPAN * rest
    return level if is_step else None


def _about_interpolation(evaluation: Evaluation) -> Iterator[Remark]:
    interpolation, position = evaluation.association.interpolation, evaluation.ate["position_m"]
    if interpolation is None or position is None:
        return
    off_m = interpolation.off_m * evaluation.alignment.similarity.scale
    if off_m <= _INTERPOLATION_SHARE * position.rmse:
        return
    yield warning(
        "interpolated_estimate",
        f"linear interpolation between the estimate's states, {interpolation.step_s:.2g} s apart, "
        f"adds an error of up to {off_m:.2g} m to the ATE; use an estimate with a higher rate",
    )
