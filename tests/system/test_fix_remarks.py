"""Warnings about GNSS fixes: which are told, and the numbers of the sentences."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.pipeline.fix_remarks import about_fixes, require_fixes_fit

COUNT = 40
CLEAN: Any = SimpleNamespace(jumps=0, single_jumps=0)


def fixes_of(sigma_m: Any = 1.0, sigma_up_m: Any = 1.0, count: int = COUNT) -> Fixes:
    level, up = (np.broadcast_to(item, count) for item in (sigma_m, sigma_up_m))
    covariances = np.zeros((count, 3, 3))
    covariances[:, 0, 0], covariances[:, 1, 1] = level**2, (0.5 * level) ** 2
    covariances[:, 2, 2] = up**2
    kinds = np.full(count, 2)
    return Fixes(np.zeros((count, 3)), np.zeros(count), kinds, covariances)


def text(
    fixes: Fixes | None = None,
    heights: Any = 0.0,
    estimated: Any = CLEAN,
    of: int = 1,
    **changed: Any,
) -> dict[str, str]:
    """Return the warnings about an evaluation that is right but for what is changed."""
    given = {
        "gauge": Gauge.YAW, "tilt_deg": 0.0, "extents": (100.0, 30.0), "weights": "none",
        "interpolation": None, "scale": 1.0, "rmse": 0.5, **changed,
    }  # fmt: skip
    fixes = fixes or fixes_of()
    along = np.linspace(-0.4, 0.6, len(fixes))
    truth = np.column_stack([along * extent for extent in (*given["extents"], 20.0)])
    rotation = Rotation.from_euler("zx", [50.0, given["tilt_deg"]], degrees=True).as_matrix()
    rmse = given["rmse"]
    evaluation: Any = SimpleNamespace(
        association=SimpleNamespace(
            groundtruth=SimpleNamespace(positions=truth, reading=SimpleNamespace(fixes=fixes)),
            interpolation=given["interpolation"],
        ),
        protocol=SimpleNamespace(gauge=given["gauge"], align_weights=given["weights"]),
        alignment=SimpleNamespace(
            similarity=SimpleNamespace(rotation=rotation, scale=given["scale"])
        ),
        aligned=SimpleNamespace(
            positions=truth - np.outer(heights * np.ones(len(fixes)), [0, 0, 1])
        ),
        ate={"position_m": None if rmse is None else SimpleNamespace(rmse=rmse)},
    )
    return {
        remark.code: remark.text
        for remark in about_fixes(evaluation, estimated, "no covariance", of)
    }


def test_a_right_evaluation_has_no_warning() -> None:
    assert text() == {}


def test_without_covariances_the_noise_of_the_fixes_is_in_the_ate() -> None:
    assert text(estimated=None) == {
        "noise_of_fixes_unknown": "the ATE includes the noise of the fixes, which can't be "
        "removed: no covariance"
    }


@pytest.mark.parametrize(
    ("jumps", "single_jumps", "of", "starts"),
    [
        (1, 0, 1, {"fixes_jump": "1 fix in jumps away from the estimate and back: "}),
        (3, 0, 2, {"fixes_jump": "3 fixes in jumps common to all 2 estimates, caused "}),
        (0, 2, 2, {"estimate_jumps": "at 2 fixes only this estimate jumps, and others do not"}),
        (
            2,
            1,
            3,
            {
                "fixes_jump": "2 fixes in jumps common to all 3 estimates",
                "estimate_jumps": "at 1 fix only this estimate jumps",
            },
        ),
        (0, 0, 2, {}),
    ],
)
def test_jumps_are_told_of_the_fixes_or_of_the_estimate(
    jumps: int, single_jumps: int, of: int, starts: dict[str, str]
) -> None:
    result = text(estimated=SimpleNamespace(jumps=jumps, single_jumps=single_jumps), of=of)
    assert result.keys() == starts.keys()
    assert all(result[code].startswith(start) for code, start in starts.items())


def test_fixes_of_two_kinds_are_told_with_the_limit_between_them() -> None:
    """The limit is the geometric mean of the widest gap; every kind has its median."""
    sigma = np.where(np.arange(COUNT) < 25, 0.02, 0.04)
    sigma[3:10] = [4.0, 5.0, 7.5, 6.0, 4.5, 5.5, 22.0]
    result = text(fixes_of(sigma))
    assert result == {
        "mixed_fixes": "7 of 40 fixes have a standard deviation of 5.5 m, the others 0.02 m "
        "(probably float and fixed RTK); exclude the former with --max-fix-sigma 0.4"
    }
    assert text(fixes_of(sigma), weights="covariance") == {}
    unknown = fixes_of(sigma)
    unknown.covariance_types[:] = 0
    assert text(unknown) == {}


def heights_with_step(
    place: int, step_m: float, noise_m: float = 0.0, back_m: float = 0.0
) -> np.ndarray[Any, Any]:
    """Return heights that change once, by alternating noise else, and come back afterwards."""
    heights = noise_m / 2.0 * (-1.0) ** np.arange(COUNT)
    heights[place:] += step_m - heights[place] + heights[place - 1]
    heights[place + 1 :] -= back_m
    return heights


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("place", "step_m", "noise_m", "back_m", "is_told"),
    [
        (20, 12.0, 0.0, 0.0, True),
        (20, 5.0, 0.0, 0.0, False),
        (3, 30.0, 0.0, 0.0, False),
        (COUNT - 3, 30.0, 0.0, 0.0, False),
        (20, 30.0, 1.0, 0.0, True),
        (20, 30.0, 8.0, 0.0, False),
        (20, 30.0, 0.0, 2.0, True),
        (20, 30.0, 0.0, 10.0, False),
    ],
)
def test_heights_that_change_once_and_stay_are_of_two_references(
    place: int, step_m: float, noise_m: float, back_m: float, sign: float, *, is_told: bool
) -> None:
    heights = sign * heights_with_step(place, step_m, noise_m, back_m)
    result = text(heights=heights)
    assert result.keys() == ({"heights_jump"} if is_told else set())
    if is_told:
        level = np.median(heights[place : place + 10]) - np.median(heights[place - 10 : place])
        assert f" change by {level:+.1f} m at once" in result["heights_jump"]
    assert text(heights=heights, gauge=Gauge.PLANAR) == {}


SPARSE = SimpleNamespace(off_m=0.05, step_s=0.5)


@pytest.mark.parametrize(
    ("evaluated", "told"),
    [
        ({"extents": (6000.0, 30.0)}, {"curvature_of_the_earth": " 6.0 km, where"}),
        ({"extents": (6000.0, 30.0), "gauge": Gauge.SE3}, {}),
        ({"extents": (3000.0, 3000.0)}, {}),
        ({"tilt_deg": 9.0, "gauge": Gauge.SE3}, {"tilted_by_heights": "by 9.0 deg to fit"}),
        ({"tilt_deg": 9.0}, {}),
        ({"tilt_deg": 3.0, "gauge": Gauge.SE3}, {}),
        ({"tilt_deg": 3.0, "gauge": Gauge.SIM3, "sigma_up_m": 20.0},
            {"tilted_by_heights": "by 3.0 deg to fit"}),
        ({"interpolation": SPARSE, "rmse": 0.2}, {"interpolated_estimate": "up to 0.05 m to"}),
        ({"interpolation": SPARSE, "rmse": 5.0}, {}),
        ({"interpolation": SPARSE, "rmse": 2.0, "scale": 10.0},
            {"interpolated_estimate": "up to 0.5 m to"}),
    ],
)  # fmt: skip
def test_large_effects_are_told(evaluated: dict[str, Any], told: dict[str, str]) -> None:
    sigma_up = np.full(COUNT, evaluated.pop("sigma_up_m", 1.0))
    remarks = text(fixes_of(sigma_up_m=sigma_up), **evaluated)
    assert remarks.keys() == told.keys()
    for code, part in told.items():
        assert part in remarks[code]


def test_fixes_need_heights_or_a_plane_and_a_common_frame_or_a_gauge() -> None:
    flat, full = fixes_of(), fixes_of()
    flat.places[:, 2] = np.nan
    plain: Any = SimpleNamespace(reading=SimpleNamespace(fixes=None))
    sides: list[Any] = [
        SimpleNamespace(reading=SimpleNamespace(fixes=item)) for item in (flat, full)
    ]
    datum = FixRule(datum=Datum(47.0, 8.0, 400.0))
    require_fixes_fit(sides[0], [plain], Gauge.PLANAR, FixRule())
    with pytest.raises(InputError, match="fixes have no height; use --gauge planar"):
        require_fixes_fit(sides[0], [plain], Gauge.YAW, FixRule())
    for gauge, estimates, rule, is_refused in (
        (Gauge.YAW, [plain], FixRule(), False),
        (Gauge.NONE, [plain], datum, False),
        (Gauge.NONE, [sides[1]], FixRule(), False),
        (Gauge.NONE, [sides[1], plain], FixRule(), True),
    ):
        if is_refused:
            with pytest.raises(InputError, match="the origin of the fixes is arbitrary"):
                require_fixes_fit(sides[1], estimates, gauge, rule)
        else:
            require_fixes_fit(sides[1], estimates, gauge, rule)
