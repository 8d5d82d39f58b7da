"""What a calibration makes of a fit: clocks apart, systematic errors, parts, warnings; the fit."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from calibration_flights import EPOCH, Fault, fly
from exact_flights import FAULT, SCALE_OF_ESTIMATE, flown
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from trajeval_ros.calibration import calibrate as module
from trajeval_ros.calibration.calibrate import SystematicErrors, _apart, _by_rows, calibrate
from trajeval_ros.calibration.clock_offset import OffsetGuess
from trajeval_ros.calibration.increments import Increments
from trajeval_ros.calibration.observability import CalibrationFit, basis_of, observability, solve
from trajeval_ros.calibration.robust_fit import fit
from trajeval_ros.calibration.significance import (
    Parameter,
    supported_by_both,
)
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory

SECOND = 1_000_000_000
NONE = SystematicErrors(0.0, 0.0)
MOVED = Fault(0.08, 0.0, (0.4, -0.7, 1.1), (0.1, -0.05, 0.2))


@pytest.fixture(scope="module")
def long() -> tuple[Trajectory, Trajectory]:
    truth, estimate = fly(5, 70.0, fault=MOVED)
    return truth[::2], estimate[::4]


@pytest.fixture(scope="module")
def solved(long: tuple[Trajectory, Trajectory]) -> tuple[Increments, CalibrationFit]:
    increments = Increments(*long)
    solution = solve(increments, Gauge.SE3, False)
    assert solution is not None
    return increments, solution


def test_time_between_trajectories() -> None:
    def at(*seconds: float) -> Trajectory:
        stamps = EPOCH + np.array([round(second * SECOND) for second in seconds])
        return Trajectory(stamps, np.zeros((len(seconds), 3)))

    truth = at(10.0, 20.0, 15.0)
    assert _apart(truth, at(23.0, 30.0), 0.0) == 3.0
    assert _apart(truth, at(1.0, 4.0), 0.0) == 6.0
    assert _apart(truth, at(1.0, 4.0), 2.5) == 3.5
    assert _apart(truth, at(15.0, 30.0), 0.0) == -5.0
    assert _apart(truth, at(0.0, 12.0), 1.0) == -3.0


def test_a_smooth_flight_has_its_exact_calibration() -> None:
    truth, estimate, unknowns = flown(duration_s=60.0)
    estimate = estimate[::2]
    found = calibrate(truth, estimate, Gauge.SIM3, systematic=NONE, with_skew=True)
    assert found.offset.value is not None
    assert found.offset.value[0] == pytest.approx(FAULT.offset_s, abs=1e-5)
    assert found.skew is not None
    assert found.skew.value is not None
    assert found.skew.value[0] == pytest.approx(FAULT.skew, abs=3e-6)
    assert found.turn.value is not None
    turned = Rotation.from_rotvec(found.turn.value).as_matrix()
    np.testing.assert_allclose(turned, unknowns.turn, atol=1e-5)
    np.testing.assert_allclose(found.lever.value, unknowns.lever_m, atol=1e-5)
    assert found.scale == pytest.approx(SCALE_OF_ESTIMATE, rel=1e-5)
    assert found.fitted == 9
    assert found.horizon_s == 1.0
    assert found.pairs == 601 - 8
    rigid = calibrate(truth, estimate, Gauge.SE3, systematic=NONE)
    assert (rigid.scale, rigid.skew) == (1.0, None)
    assert rigid.fitted == 7


def test_systematic_errors_are_doubled_for_runs_below_a_minute(
    long: tuple[Trajectory, Trajectory],
) -> None:
    truth, estimate = long
    for last_s, factor in ((59.4, 2.0), (61.0, 1.0)):
        part = estimate[(estimate.stamps - EPOCH) < (last_s + 1.0) * 1e9]
        bare, wide = (
            calibrate(truth, part, systematic=SystematicErrors(*sigmas))
            for sigmas in ((0.0, 0.0), (2e-3, 0.003))
        )
        for name, added in (("offset", factor * 2e-3), ("turn", 0.003), ("lever", 0.0)):
            before, after = (getattr(item, name).sigma for item in (bare, wide))
            np.testing.assert_allclose(after**2 - before**2, added**2, rtol=1e-6)


def test_offsets_of_rotations_and_positions_apart(
    monkeypatch: pytest.MonkeyPatch,
    long: tuple[Trajectory, Trajectory],
    solved: tuple[Increments, CalibrationFit],
) -> None:
    increments, solution = solved
    rows, apart_s = _by_rows(increments, solution.fit, 3 * SECOND)
    assert set(rows) == {"rotation", "position"}
    for offset, sigma in rows.values():
        assert offset == pytest.approx(3.08, abs=5.0 * sigma + 1e-3)
        assert 0.0 < sigma < 0.01
    assert apart_s == 0.0
    # Significant from three standard deviations on, by Student's t.
    real, blocks = module.fit, solution.fit.blocks
    sigma = float(np.hypot(np.hypot(rows["rotation"][1], rows["position"][1]), 1e-5))
    limit = float(student.isf(0.0027 / 2.0, blocks - 1)) * sigma
    gap = rows["position"][0] - rows["rotation"][0]
    for factor in (0.99, 1.01):
        shift = factor * limit - gap

        def shifted(*given: Any, shift: float = shift) -> Any:
            found = real(*given)
            assert found is not None
            added = shift if given[2].shape[1] == 7 else 0.0  # with a lever arm: of positions
            moved = dataclasses.replace(found.unknowns, offset_s=found.unknowns.offset_s + added)
            return dataclasses.replace(found, unknowns=moved)

        monkeypatch.setattr(module, "fit", shifted)
        _, apart_s = _by_rows(increments, solution.fit, 0)
        expected = factor * limit if factor > 1.0 else 0.0
        assert apart_s == pytest.approx(expected, rel=1e-6)
    # Half of the difference is an uncertainty of the offset.
    found = calibrate(*long, systematic=NONE)
    assert found.offset.sigma is not None
    apart_s = abs(found.rows["position"][0] - found.rows["rotation"][0])
    variance = float(solution.fit.covariance[0, 0]) + 1e-10 + (apart_s / 2.0) ** 2
    assert found.offset.sigma[0] == pytest.approx(np.sqrt(variance), rel=0.02)


def test_a_skew_of_less_than_two_minutes_is_warned_of(
    long: tuple[Trajectory, Trajectory],
) -> None:
    truth, estimate = long
    found = calibrate(truth, estimate, with_skew=True, systematic=NONE)
    assert [remark.code for remark in found.remarks] == ["short_for_clock_skew"]
    assert "from 69 s is unreliable; use at least 120 s" in found.remarks[0].text


def test_a_fit_stops_at_the_least_squares_solution() -> None:
    """Without outliers, at a normal matrix times the step of zero."""
    truth, estimate, unknowns = flown(duration_s=40.0)
    estimate = estimate[::2]
    generator = np.random.default_rng(0)
    estimate = dataclasses.replace(
        estimate, positions=estimate.positions + 1e-3 * generator.normal(size=(401, 3))
    )
    increments = Increments(truth, estimate)
    basis = np.eye(9)
    found = fit(increments, unknowns.moved(np.full(9, 1e-3)), basis)
    assert found is not None
    assert found.settled
    assert found.free == 9
    assert found.blocks == 12
    rows = np.repeat(found.weights, 3, axis=1)
    weighted = found.linearised.jacobian * rows[..., None]
    hessian = np.einsum("nap,naq->pq", weighted, found.linearised.jacobian)
    gradient = np.einsum("nap,na->p", weighted, found.linearised.residual)
    step = np.linalg.solve(hessian, gradient)
    assert (np.abs(step) * np.sqrt(np.diag(hessian)) < 1e-3).all()


def test_a_fit_of_few_directions_moves_along_them_alone(
    long: tuple[Trajectory, Trajectory],
) -> None:
    truth, estimate = long
    increments = Increments(truth, estimate)
    begin = increments.start(0.05, with_scale=False, about_z=False)
    axis = np.array([[0.6, 0.0, 0.8]])
    found = fit(increments, begin, basis_of({"offset": np.eye(1), "lever": axis}))
    assert found is not None
    moved = found.unknowns.lever_m - begin.lever_m
    np.testing.assert_allclose(moved, axis[0] * (axis[0] @ moved), atol=1e-12)
    np.testing.assert_array_equal(found.unknowns.turn, begin.turn)
    assert found.unknowns.skew == 0.0
    fixed = [1, 2, 3, 4, 6, 8]
    assert not found.covariance[fixed].any()
    seen = observability(increments, found)
    assert set(seen) == {"offset", "skew", "turn", "lever"}


@pytest.mark.parametrize(
    ("by_rotation", "by_position", "chance", "kept"),
    [
        (0.021, -0.499, 1.0, True),
        (0.02 - 1e-9, -0.499, 0.0028, False),
        (0.02 - 1e-9, -0.499, 0.0026, True),
        (0.9, -0.5, 0.0, False),
    ],
)
def test_a_rotation_is_supported_by_both_kinds_of_rows(
    monkeypatch: pytest.MonkeyPatch,
    solved: tuple[Increments, CalibrationFit],
    by_rotation: float,
    by_position: float,
    chance: float,
    kept: bool,
) -> None:
    from trajeval_ros.calibration import significance

    increments, solution = solved
    turn = Parameter(np.ones(3), np.ones(3), np.ones(3), np.ones(3), "significant", "")
    costs = iter([1.0 - by_rotation, 1.0, 1.0 - by_position, 1.0])
    monkeypatch.setattr(significance, "huber_cost", lambda *_: next(costs))
    monkeypatch.setattr(significance, "_by_rotations_alone", lambda *_: chance)
    found = supported_by_both(turn, increments, solution, 0.0)
    assert found.is_significant == kept
    weak = dataclasses.replace(turn, status="weak")
    assert supported_by_both(weak, increments, solution, 0.0) is weak


@pytest.mark.parametrize(("count", "enough"), [(29, False), (30, True)])
def test_a_solution_needs_thirty_pairs(count: int, enough: bool) -> None:
    class Pairs:
        has_turns = has_lever = False

        def __len__(self) -> int:
            return count

        def start(self, *_: Any, **__: Any) -> Any:
            raise StopIteration

    pairs: Any = Pairs()
    if enough:
        with pytest.raises(StopIteration):
            solve(pairs, Gauge.SE3, False)
    else:
        assert solve(pairs, Gauge.SE3, False) is None


def test_useful_parameters_are_as_precise_as_this() -> None:
    """10 ms, 100 ppm, 2 deg and 0.1 m at 95 %."""
    limits = {name: float(value) for name, value in module.WIDEST.items()}
    assert limits.pop("turn") == pytest.approx(np.radians(2.0))
    assert limits == {"offset": 0.010, "skew": 100e-6, "lever": 0.1}


def test_solutions_need_pairs_and_blocks() -> None:
    truth, estimate, _ = flown()
    assert solve(Increments(truth, estimate, 29), Gauge.SE3, False) is None
    # Of 20 s, seven blocks of 3 s determine fewer than five parameters.
    found = solve(Increments(truth, estimate), Gauge.SE3, False)
    assert found is None or found.left_out


def test_what_is_fitted_depends_on_sensors_and_gauge(long: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = long
    bare = dataclasses.replace(truth, quaternions=None)
    nothing = dataclasses.replace(estimate, quaternions=None)
    body = {"offset": 1, "turn": 3, "lever": 3}
    for one, other, gauge, skew, expected in (
        (truth, estimate, Gauge.SE3, False, body),
        (truth, estimate, Gauge.SIM3, True, {**body, "scale": 1, "skew": 1}),
        (bare, estimate, Gauge.YAW, False, {"offset": 1, "turn": 1, "lever": 3}),
        (bare, nothing, Gauge.SE3, False, {"offset": 1, "turn": 3}),
    ):  # fmt: skip
        solution = solve(Increments(one, other), gauge, skew)
        assert solution is not None
        assert {name: len(axes) for name, axes in solution.free.items()} == expected
        assert solution.left_out == ""
        assert solution.fit.free == sum(expected.values())


@pytest.mark.parametrize(
    ("overlap_s", "around_s", "search_s"),
    [(5.0, 0.0, 5.0), (4.99, 0.0, None), (3.0, 2.0, 5.0), (3.0, 1.99, None), (30.0, -26.0, None)],
)
def test_all_offsets_are_searched_if_the_usual_ones_leave_too_little(
    monkeypatch: pytest.MonkeyPatch, overlap_s: float, around_s: float, search_s: float | None
) -> None:
    """Within 5 s around the given offset, trajectories must be able to overlap for 10 s."""
    calls: list[dict[str, Any]] = []

    def stop(*_: Any, **given: Any) -> Any:
        calls.append(given)
        raise StopIteration

    monkeypatch.setattr(module, "guess_offset", stop)
    seconds = np.arange(0.0, 30.01, 0.5)
    truth = Trajectory(EPOCH + (seconds * SECOND).astype(np.int64), np.zeros((61, 3)))
    earlier = round((30.0 - overlap_s) * SECOND)
    estimate = dataclasses.replace(truth, stamps=truth.stamps - earlier)
    with pytest.raises(StopIteration):
        calibrate(truth, estimate, around_s=around_s)
    assert calls == [{"around_s": around_s, "search_s": search_s}]


def test_an_unusable_guess_leaves_the_given_offset(
    monkeypatch: pytest.MonkeyPatch, long: tuple[Trajectory, Trajectory]
) -> None:
    seen: list[int] = []
    truth, estimate = long

    def stop(_: Trajectory, shifted: Trajectory, __: int) -> Any:
        seen.append(int(shifted.stamps[0] - estimate.stamps[0]))
        raise StopIteration

    monkeypatch.setattr(module, "Increments", stop)
    for problem in ("", "why"):
        guess = OffsetGuess(0.25, 0.9, 0.1, 9.0, "speed", 30.0, problem)
        monkeypatch.setattr(module, "guess_offset", lambda *_, guess=guess, **__: guess)
        with pytest.raises(StopIteration):
            calibrate(truth, estimate, around_s=0.125)
    assert seen == [SECOND // 4, SECOND // 8]
