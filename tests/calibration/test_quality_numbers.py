"""What an examination makes of its fits: units, standard deviations, and what is applied."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examined_rigs import rig
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from small_rigs import small_rig

from trajeval_ros.calibration.groundtruth_quality.examine import (
    ExaminedGroundtruth,
    _apply,
    examine,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_quality.quality_causes import (
    HALF_WIDTH,
    PARAMETERS,
    GroundtruthCause,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_quality.rig import LEVER, OFFSET, SKEW, UNITS
from trajeval_ros.calibration.groundtruth_quality.start import imu_of
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.inertial import InertialReadings

Array = NDArray[np.float64]
# Standard deviations of errors that a recording does not reveal: deg, mm, ms, ppm, deg.
FLOORS = np.array([0.05] * 3 + [1.0] * 4 + [20.0] + [0.07] * 2)
MADE = rig(6, duration_s=24.0, turn_deg=(3.0, -2.0, 1.5), lever_m=(0.05, -0.03, 0.02),
           offset_s=0.012, skew=3e-4, tilt_deg=1.5)  # fmt: skip


@pytest.fixture(scope="module")
def outcome() -> ExaminedGroundtruth:
    return examine(MADE.groundtruth, MADE.readings)


def floors_along_force() -> Array:
    assert MADE.readings.accelerations is not None
    force = MADE.readings.accelerations.mean(axis=0)
    floors = FLOORS.copy()
    floors[LEVER] = np.hypot(1.0, 3.0 * force / np.linalg.norm(force))
    return floors


def test_causes_are_those_of_the_short_fit(outcome: ExaminedGroundtruth) -> None:
    assert outcome.fits is not None
    assert not outcome.fits.disagree
    brief = outcome.fits.short
    sigmas = np.hypot(brief.sigmas, floors_along_force())
    for name, parameter in PARAMETERS.items():
        value, sigma = brief.values[parameter.columns], sigmas[parameter.columns]
        cause = outcome.causes[name]
        size = float(np.linalg.norm(value))
        assert cause.value == pytest.approx(size, rel=1e-12)
        along = np.linalg.norm(value * sigma) / size
        assert cause.standard_deviation == pytest.approx(along, rel=1e-9)
        np.testing.assert_array_equal(cause.components, value)
    fused = abs(np.linalg.norm(outcome.fits.long.values[:3]) - np.linalg.norm(brief.values[:3]))
    assert outcome.causes["fused"].value == pytest.approx(fused)
    in_metres = np.square(sigmas[:6] / UNITS[:6])
    covariance = outcome.fits.hand_eye_covariance
    np.testing.assert_allclose(np.diag(covariance)[:3], in_metres[3:], rtol=1e-9)
    body = outcome.fits.rig.body
    expected = body @ np.diag(in_metres[:3]) @ body.T
    np.testing.assert_allclose(covariance[3:, 3:], expected, rtol=1e-9, atol=1e-15)
    assert not covariance[:3, 3:].any()


def test_what_is_repaired_is_what_is_found(outcome: ExaminedGroundtruth) -> None:
    assert outcome.fits is not None
    fits, values = outcome.fits, outcome.fits.short.values
    assert fits.rig.offset_s == pytest.approx(values[6] / 1e3, abs=2e-4)
    assert fits.rig.skew == pytest.approx(values[7] / 1e6, abs=2e-5)
    np.testing.assert_allclose(fits.hand_eye.lever_m, fits.rig.lever)
    np.testing.assert_allclose(fits.hand_eye.lever_m, values[LEVER] / 1e3, atol=1e-3)
    rotated = Rotation.from_quat(fits.hand_eye.rotation_xyzw).as_matrix()
    np.testing.assert_allclose(rotated, fits.rig.body, atol=1e-12)
    assert np.linalg.norm(fits.rig.gravity) == pytest.approx(9.81)
    # Times of the residuals are of the knots, half a second inside.
    seconds = fits.short.seconds
    np.testing.assert_allclose(np.diff(seconds), 0.05, atol=0.051)
    assert -0.06 < seconds[0] < 0.2
    assert fits.short.residuals.shape == (len(seconds), 2)
    noise_of_means = np.array([5e-4, 2e-3]) / np.sqrt(5.0)
    rms = np.sqrt(np.square(fits.short.residuals).mean(axis=0) / 3.0)
    # Five samples of a knot are averaged, and the fit takes a part of their noise.
    assert (0.4 * noise_of_means < rms).all()
    assert (rms < noise_of_means).all()


@pytest.mark.slow
def test_positions_alone_have_wider_clocks() -> None:
    bare = dataclasses.replace(MADE.groundtruth, quaternions=None)
    result = examine(bare, MADE.readings)
    assert result.fits is not None
    brief, lasting = result.fits.short, result.fits.long
    apart = np.abs(lasting.values - brief.values)
    floors = floors_along_force()
    floors[3:] = np.maximum(floors[3:], apart[3:])
    floors[OFFSET] = max(floors[OFFSET], 3.0)
    sigmas = np.hypot(brief.sigmas, floors)
    for name in ("clock_offset", "clock_skew"):
        column = PARAMETERS[name].columns.start
        assert result.causes[name].standard_deviation == pytest.approx(sigmas[column], rel=1e-9)
    size = np.linalg.norm(brief.values[LEVER])
    along = np.linalg.norm(brief.values[LEVER] * sigmas[LEVER]) / size
    assert result.causes["lever_arm"].standard_deviation == pytest.approx(along, rel=1e-9)
    # A clock whose interval contains zero is not applied.
    skew = abs(brief.values[SKEW]) >= HALF_WIDTH * sigmas[SKEW]
    assert (result.fits.rig.skew != 0.0) == skew


@pytest.mark.parametrize(
    ("size", "refused"), [(4.99, True), (5.01, False), (19.9, False), (20.1, True)]
)
def test_accelerations_are_in_metres(size: float, refused: bool) -> None:
    stamps = np.array([30, 10, 20, 10])
    readings = InertialReadings(
        stamps, np.arange(12.0).reshape(4, 3), np.tile([0.0, size, 0.0], (4, 1))
    )
    if refused:
        with pytest.raises(InputError, match="specific forces"):
            imu_of(readings)
        return
    imu = imu_of(readings)
    assert imu.origin == 10
    np.testing.assert_allclose(imu.seconds, [0.0, 1e-8, 2e-8], atol=1e-20)
    assert imu.rates[:, 0].tolist() == [3.0, 6.0, 0.0]
    gyroscope = imu_of(dataclasses.replace(readings, accelerations=None))
    assert not gyroscope.accelerations.any()


def test_a_summary_has_the_larger_variance_in_its_units() -> None:
    fit = small_rig().fit()
    fit.rig = dataclasses.replace(fit.rig, shift_s=0.5)
    result = fit.summary()
    assert result.values[OFFSET] == pytest.approx(520.0)
    np.testing.assert_allclose(result.values, fit.rig.values() * UNITS)
    variances = [np.diag(item) for item in (fit.covariance_of_blocks, fit.covariance_of_model)]
    np.testing.assert_allclose(result.sigmas, np.sqrt(np.maximum(*variances)) * UNITS)
    np.testing.assert_allclose(result.seconds, fit.steps.knots[:4] - 0.1, atol=1e-12)
    lengths = np.linalg.norm(fit.rows.residuals.reshape(4, 2, 3), axis=2)
    np.testing.assert_allclose(result.residuals, lengths)
    assert UNITS.tolist() == pytest.approx(
        [np.degrees(1.0)] * 3 + [1e3] * 4 + [1e6] + [np.degrees(1.0)] * 2
    )


@pytest.mark.parametrize(
    ("verdict", "lever"),
    [
        ("significant", [False, False, False]),
        ("insignificant", [True, False, True]),
        ("inconclusive", [True, True, True]),
    ],
)
@pytest.mark.parametrize("is_short", [True, False])
def test_parameters_that_are_noise_are_not_applied(
    verdict: str, lever: list[bool], is_short: bool
) -> None:
    calls: list[tuple[Any, Array]] = []
    own = dataclasses.replace(small_rig().rig, offset_s=0.25, skew=0.125)

    def fake(offset_s: float, skew: float) -> Any:
        given = dataclasses.replace(own, offset_s=offset_s, skew=skew, shift_s=0.75)
        return SimpleNamespace(
            free=np.ones(10, dtype=bool), rig=given, solve_again=lambda *given: calls.append(given)
        )

    chosen, other = fake(0.25, 0.125), fake(0.5, 0.0625)
    causes = {name: GroundtruthCause(name, "significant") for name in PARAMETERS}
    causes["body_rotation"] = GroundtruthCause("body_rotation", "insignificant")
    causes["tilted"] = GroundtruthCause("tilted", "insignificant")
    causes["lever_arm"] = GroundtruthCause("lever_arm", verdict)
    noisy = np.array([True] * 3 + [True, False, True] + [False, True, False, False])
    _apply(chosen, chosen if is_short else other, causes, noisy)
    [(applied, free)] = calls
    np.testing.assert_array_equal(applied.body, np.eye(3))
    np.testing.assert_array_equal(applied.lever == 0.0, lever)
    # Clocks are those of the short fit; a noisy skew is zero.
    assert applied.offset_s == (0.25 if is_short else 0.5)
    assert applied.skew == 0.0
    expected = np.array([False] * 3 + [not item for item in lever] + [is_short, False, True, True])
    np.testing.assert_array_equal(free, expected)
    # A rotation that is not noise is applied, also a small one, but not an inconclusive one.
    for verdict in ("insignificant", "inconclusive"):
        causes["body_rotation"] = GroundtruthCause("body_rotation", verdict)
        _apply(chosen, chosen, causes, noisy & (np.arange(10) > 2))
        applied, free = calls.pop()
        is_applied = verdict == "insignificant"
        np.testing.assert_array_equal(applied.body, own.body if is_applied else np.eye(3))
        assert free[:3].tolist() == [is_applied] * 3
