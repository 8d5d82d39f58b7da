"""Limits of the diagnosis, from both sides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from trajeval_ros.diagnosis.clock_tests import other_rate
from trajeval_ros.diagnosis.convention_tests import conventions
from trajeval_ros.diagnosis.trials import with_tried_advice

from trajeval_ros.diagnosis import convention_tests
from trajeval_ros.diagnosis.diagnose import _tests_of_geometry
from trajeval_ros.diagnosis.findings import Diagnosis, Finding
from trajeval_ros.diagnosis.hypotheses import (
    AS_READ,
    TRANSPOSED,
    WXYZ,
    Hypothesis,
    improper_permutations,
)
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.diagnosis.input_tests import rounded_stamps

NO_TURNS: Any = SimpleNamespace(
    turns=None,
    groundtruth_turned=None,
    estimate_turned=None,
    true_steps=np.ones((5, 3)),
    steps=np.ones((5, 3)),
)


def hypothesis(cause: str, changes: int, cost: float) -> Hypothesis:
    return Hypothesis(cause, "estimate", changes, cost, np.eye(3), 1.0, 1.0, 0.0, np.eye(3))


@pytest.mark.parametrize(("saved", "agreement"), [(0.01, 90.0), (0.03, 93.0)])
def test_another_change_of_the_convention_must_explain_more(
    saved: float, agreement: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = [hypothesis(WXYZ, 1, 0.1), hypothesis(WXYZ, 2, 0.1 - saved)]
    monkeypatch.setattr(convention_tests, "fit_others", lambda *_: others)
    found = conventions(hypothesis(AS_READ, 0, 0.99), NO_TURNS, NO_TURNS, None)
    [seen] = found.seen
    assert seen.cause == WXYZ
    assert seen.values["agreement"] == pytest.approx(agreement)
    assert TRANSPOSED not in found.scores


@pytest.mark.parametrize(
    ("step_s", "shared", "moving", "named_s"),
    [
        (1.0, 3, 1.0, 1.0),
        (0.5, 3, 1.0, 0.5),
        (0.1, 3, 1.0, 0.1),
        (0.75, 3, 1.0, None),
        (0.25, 3, 1.0, None),
        (1.0, 2, 1.0, 1.0),
        (1.0, 1, 1.0, None),
        (1.0, 3, 0.6, 1.0),
        (1.0, 3, 0.4, None),
    ],
)
def test_rounded_timestamps_have_steps_of_clocks_and_moving_poses(
    step_s: float, shared: int, moving: float, named_s: float | None
) -> None:
    seconds = step_s * (1 + np.arange(120) // shared)
    positions = np.cumsum(np.outer(np.arange(120) % 10 < 10 * moving, np.ones(3)), axis=0)
    poses = TimedPoses(seconds, positions)
    read = SimpleNamespace(stamps=np.rint(seconds * 1e9).astype(np.int64))
    true = SimpleNamespace(stamps=np.arange(120, dtype=np.int64) * 12_345_678)
    inputs: Any = SimpleNamespace(
        estimate_poses=poses, groundtruth_poses=poses, estimate=read, groundtruth=true
    )
    found = [seen.values["step_s"] for seen in rounded_stamps(inputs).seen]
    assert found == ([] if named_s is None else [pytest.approx(named_s)])


@pytest.mark.parametrize(
    ("offset_s", "peak", "overlap_s", "is_other"),
    [
        (9.0, 0.4, 60.0, True),
        (0.2, 0.4, 60.0, False),
        (9.0, 0.75, 60.0, False),
        (9.0, 0.4, 14.0, False),
    ],
)
def test_another_run_has_an_offset_a_low_peak_and_a_long_overlap(
    offset_s: float,
    peak: float,
    overlap_s: float,
    is_other: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    match: Any = SimpleNamespace(offset_s=offset_s, peak=peak, overlap_s=overlap_s)
    monkeypatch.setattr(convention_tests, "fit_others", lambda *_: [hypothesis(WXYZ, 1, 0.9)])
    found = conventions(hypothesis(AS_READ, 0, 0.99), NO_TURNS, NO_TURNS, match)
    assert [seen.cause for seen in found.seen] == (["other_run"] if is_other else [])


@pytest.mark.parametrize(
    ("position", "rotation", "is_stated"),
    [
        (1.0, 1.0, True),
        (1.09, 1.09, True),
        (1.1, 1.0, False),
        (1.0, 1.1, False),
        (1.2, 0.99, False),
        (0.99, 1.2, False),
        (1.0, None, True),
        (1.1, None, False),
    ],
)
@pytest.mark.parametrize("is_gone", [True, False])
def test_a_finding_whose_correction_helps_little_is_stated_unless_an_error_grows(
    position: float, rotation: float | None, is_gone: bool, is_stated: bool
) -> None:
    finding = Finding("unit", "", "", {"estimate": "mm"}, 1.0, {})
    left = () if is_gone else (Finding("unit", "", "", {}, 1.0, {}),)
    kept = with_tried_advice(
        Diagnosis((finding,)),
        with_errors(1.0, 1.0),
        lambda _: (with_errors(position, rotation), Diagnosis(left)),
    ).findings
    assert [each.cause for each in kept] == ["unit"] * (is_stated and is_gone)
    assert all(not each.correction for each in kept)


def with_errors(position_m: float, rotation_deg: float | None) -> Any:
    """Return an evaluation with these RMSEs."""
    rmses = {"position_m": position_m, "rotation_deg": rotation_deg}
    found = {
        name: None if each is None else SimpleNamespace(rmse=each) for name, each in rmses.items()
    }
    return SimpleNamespace(ate=found)


@pytest.mark.parametrize(
    ("overlap_s", "peak", "causes"),
    [(21.0, 0.44, ["other_run"]), (19.0, 0.44, []), (20.0, 0.44, []), (21.0, 0.46, [])],
)
def test_without_short_motions_another_run_has_a_low_peak_and_a_long_overlap(
    overlap_s: float, peak: float, causes: list[str]
) -> None:
    poses = TimedPoses(np.array([0.0, 100.0]), np.zeros((2, 3)))
    inputs: Any = SimpleNamespace(max_gap_s=0.5, by_time=True)
    match: Any = SimpleNamespace(overlap_s=overlap_s, peak=peak)
    [examined] = _tests_of_geometry(inputs, poses, poses, match)
    assert [seen.cause for seen in examined.seen] == causes


def test_a_clock_rate_is_not_searched_in_a_gap() -> None:
    seconds = np.array([0.0, 1.0, 2.0, 200.0, 201.0])
    poses = TimedPoses(seconds, np.cumsum(np.ones((5, 3)), axis=0))
    assert other_rate(poses, poses, None) == (1.0, None)
    assert other_rate(poses[:1], poses[:1], None) == (1.0, None)


def test_axes_that_change_the_handedness_begin_with_a_flipped_y() -> None:
    """The first of equal ones is taken: flips come before exchanges, and y before x and z."""
    found = improper_permutations()
    assert len(np.unique(found, axis=0)) == 24
    np.testing.assert_allclose(np.linalg.det(found), -1.0)
    assert set(np.abs(found).sum(axis=1).ravel()) == {1.0}
    traces = np.einsum("nii->n", found)
    assert (np.diff(traces) <= 0.0).all()
    np.testing.assert_array_equal(found[0], np.diag([1.0, -1.0, 1.0]))
    for trace in set(traces):
        assert (np.diff(found[traces == trace][:, 1, 1]) >= 0.0).all()
