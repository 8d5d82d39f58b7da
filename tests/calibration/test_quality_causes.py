"""Verdicts of the groundtruth quality check at their limits, and their sentences."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import f as fisher

from trajeval_ros.calibration.groundtruth_quality.quality_causes import (
    GroundtruthCause,
    discontinuity_causes,
    fused_cause,
    parameter_causes,
    sample_causes,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_quality.sample_checks import (
    GroundtruthJump,
    PoseChecks,
    PoseSpan,
    ResidualChecks,
)  # fmt: skip
from trajeval_ros.metrics.discontinuities.events import Event

Array = NDArray[np.float64]


def checks(**changed: Any) -> PoseChecks:
    given = {
        "rate_hz": 100.0, "gaps": (), "missing_share": 0.0, "repeated_stamps": 0,
        "interval_sigma_s": 0.0, "held_share": 0.0, "frozen": (), "position_noise_m": 1e-3,
        "rotation_noise_rad": 1e-3,
    }  # fmt: skip
    return PoseChecks(**{**given, **changed})


def verdict(name: str, causes: list[GroundtruthCause]) -> tuple[bool, float | None, str]:
    [cause] = [item for item in causes if item.name == name]
    return cause.verdict == "significant", cause.value, cause.sentence


@pytest.mark.parametrize(
    ("name", "below", "above", "message"),
    [
        ("missing", {"missing_share": 0.00999}, {"missing_share": 0.0101}, "1.0 % of the poses"),
        ("held", {"held_share": 0.0199}, {"held_share": 0.0201}, "2.0 % of the poses in motion"),
        (
            "uneven_timestamps",
            {"interval_sigma_s": 0.99e-3},
            {"interval_sigma_s": 1.01e-3},
            "vary by 1.01 ms, 10 % of their length",
        ),
        ("repeated_timestamps", {}, {"repeated_stamps": 1}, "1 timestamp repeated"),
        (
            "gaps",
            {},
            {"gaps": (PoseSpan(5 * 10**9, 1.5), PoseSpan(7 * 10**9, 0.5))},
            "2 gaps; the longest is 1.50 s at 3.00 s.",
        ),
        (
            "frozen",
            {},
            {"frozen": (PoseSpan(5 * 10**9, 1.5),)},
            "1 time; the longest is 1.50 s at 3.00 s.",
        ),
    ],
)
def test_limits_of_faults_of_poses(
    name: str, below: dict[str, Any], above: dict[str, Any], message: str
) -> None:
    for changed, result in ((below, False), (above, True)):
        is_found, _, sentence = verdict(name, sample_causes(checks(**changed), None, 2 * 10**9))
        assert is_found == result
        assert (message in sentence) == result


@pytest.mark.parametrize(
    ("name", "below", "above", "message"),
    [
        (
            "jitter",
            {"jitter_s": 1e-3, "jitter_sigmas": 4.0},
            {"jitter_s": 1e-3, "jitter_sigmas": 4.1},
            "errors of 1.0 ms",
        ),
        ("jitter", {"jitter_s": 1.9e-4}, {"jitter_s": 2.1e-4}, "errors of 0.2 ms"),
        ("outliers", {"outlier_share": 0.0049}, {"outlier_share": 0.0051}, "0.5 % of the poses"),
        (
            "rotation_jumps",
            {"jumps": (GroundtruthJump(10**9, "position", 1.0),)},
            {"jumps": (GroundtruthJump(5 * 10**9, "rotation", np.radians(3.0)),)},
            "1 rotation jump of up to 3.00 deg; the largest is at 3.00 s",
        ),
        (
            "position_jumps",
            {},
            {
                "jumps": (
                    GroundtruthJump(4 * 10**9, "position", 0.02),
                    GroundtruthJump(5 * 10**9, "position", 0.03),
                )
            },
            "2 position jumps of up to 30 mm; the largest is at 3.00 s",
        ),
    ],
)
def test_limits_of_faults_of_residuals(
    name: str, below: dict[str, Any], above: dict[str, Any], message: str
) -> None:
    given: dict[str, Any] = {
        "jitter_s": 0.0, "jitter_sigmas": 10.0, "outlier_share": 0.0, "jumps": (),
        "noisy_steps": (),
    }  # fmt: skip
    for changed, result in ((below, False), (above, True)):
        residuals = ResidualChecks(**{**given, **changed})
        causes = sample_causes(checks(), residuals, 2 * 10**9)
        is_found, _, sentence = verdict(name, causes)
        assert is_found == result
        assert (message in sentence) == result


def parameter_cause(
    name: str, values: Array, sigmas: Array, free: NDArray[np.bool_], axes: str
) -> GroundtruthCause:
    result = SimpleNamespace(values=values, sigmas=sigmas, fixed_axes=axes)
    causes = parameter_causes(result, free)  # type: ignore[arg-type]
    return {item.name: item for item in causes}[name]


def fused(short_deg: float, long_deg: float, *, disagree: bool) -> GroundtruthCause:
    short, long = (
        SimpleNamespace(
            values=np.array([0.6 * angle, 0.0, -0.8 * angle, *[9.0] * 7]),
            noise=np.radians([9.0, 9.0, 9.0, 0.15, 0.2, 0.0]),
        )
        for angle in (short_deg, long_deg)
    )
    return fused_cause(short, long, disagree=disagree)  # type: ignore[arg-type]


def calibration(columns: slice, value: float, sigma: float) -> tuple[Array, Array]:
    values, sigmas = np.zeros(10), np.full(10, 1e-9)
    values[columns.start], sigmas[columns] = value, sigma
    return values, sigmas


@pytest.mark.parametrize(
    ("name", "columns", "least", "limit"),
    [
        ("body_rotation", slice(0, 3), 0.2, 2.0),
        ("lever_arm", slice(3, 6), 3.0, 50.0),
        ("clock_offset", slice(6, 7), 2.0, 10.0),
        ("clock_skew", slice(7, 8), 50.0, 500.0),
        ("tilted", slice(8, 10), 0.3, 2.0),
    ],
)
def test_verdicts_on_parameters(name: str, columns: slice, least: float, limit: float) -> None:
    free = np.ones(10, dtype=bool)
    size = columns.stop - columns.start

    def cause(value: float, sigma: float, axes: str = "") -> GroundtruthCause:
        return parameter_cause(name, *calibration(columns, value, sigma), free, axes)

    assert cause(0.99 * least, 1e-6).verdict == "insignificant"
    assert cause(1.01 * least, 1e-6).verdict == "significant"
    # Wald's test with twelve blocks, at the chance of three standard deviations.
    critical = np.sqrt(size * fisher.isf(0.0027, size, 11))
    sigma = 0.1 * limit
    assert cause(0.999 * critical * sigma, sigma).verdict == "insignificant"
    result = cause(1.001 * critical * sigma, sigma)
    assert result.verdict == "significant"
    assert result.p_value == pytest.approx(0.0027, rel=0.02)
    assert result.value == pytest.approx(1.001 * critical * sigma)
    assert result.standard_deviation == pytest.approx(sigma)
    assert result.half_width == pytest.approx(2.201 * sigma)
    assert cause(0.0, 0.99 * limit / 2.201).verdict == "insignificant"
    assert cause(0.0, 1.01 * limit / 2.201).verdict == "inconclusive"
    assert cause(0.0, 1.0).standard_deviation == 1.0
    fixed = cause(0.0, 1e-6, "z").verdict
    assert fixed == ("inconclusive" if name == "lever_arm" else "insignificant")
    free[columns] = False
    assert cause(1e3, 1.0).verdict == "inconclusive"
    assert cause(1e3, 1.0).value is None


def test_sentences_on_the_clock_have_a_direction() -> None:
    free = np.ones(10, dtype=bool)
    for value, text in (
        (12.0, "12.0 ms (± 2.2 ms at 95 %) early: add"),
        (-12.0, "late: subtract"),
    ):
        cause = parameter_cause("clock_offset", *calibration(slice(6, 7), value, 1.0), free, "")
        assert text in cause.sentence
    skew = parameter_cause("clock_skew", *calibration(slice(7, 8), 1000.0, 1.0), free, "")
    assert "1000 ppm" in skew.sentence
    assert "3.60 s per hour" in skew.sentence
    result = fused(1.0, 3.5, disagree=True)
    assert (result.verdict, result.value) == ("significant", pytest.approx(2.5))
    assert "over 0.1 s and over 2 s disagree (1.0 and 3.5 deg)" in result.sentence
    assert result.sentence.endswith("uncertain by 0.25 deg.")
    result = fused(3.5, 1.0, disagree=False)
    assert (result.verdict, result.value) == ("insignificant", pytest.approx(2.5))


def test_a_standard_deviation_is_along_the_value() -> None:
    values, sigmas = np.zeros(10), np.full(10, 0.01)
    values[:3], sigmas[:3] = [3.0, 4.0, 0.0], [0.1, 0.2, 9.0]
    cause = parameter_cause("body_rotation", values, sigmas, np.ones(10, dtype=bool), "")
    assert cause.standard_deviation == pytest.approx(np.hypot(0.3, 0.8) / 5.0)


def event(kind: str, at_s: float, **changed: float) -> Event:
    stamp = 1_000 + round(at_s * 1e9)
    return Event(kind, "groundtruth", stamp, stamp, **changed)


def test_discontinuities_of_the_poses_are_counted_with_the_largest() -> None:
    events = [
        event("flip", 3.0, deg=180.0, ratio=90.0),
        event("step", 5.0, m=0.05, ratio=1.8),
        event("step", 9.0, m=0.5, deg=4.0, ratio=18.0),
        event("lost", 12.0, m=0.2, ratio=7.0),
        event("clock_step", 20.0, s=-0.25),
        event("gap", 30.0, s=2.0),
        event("frozen_position", 40.0, s=2.0),
    ]
    causes = {cause.name: cause for cause in discontinuity_causes(events, 1_000)}
    assert {name: cause.value for name, cause in causes.items()} == {
        "steps": 3.0, "outliers": 0.0, "flips": 1.0, "lasting_flips": 0.0, "clock_steps": 1.0,
    }  # fmt: skip
    assert causes["steps"].sentence == (
        "3 steps of up to 0.50 m and 4 deg; the largest is at 9.00 s."
    )
    drop = "evaluate with --drop-groundtruth-outliers"
    assert causes["flips"].sentence == f"1 flip of 180 deg at 3.00 s; {drop}."
    assert causes["outliers"].sentence == ""
    assert causes["outliers"].verdict == "insignificant"
    assert "clock step of -0.250 s at 20.00 s" in causes["clock_steps"].sentence
