"""Values of settings at their limits, and joint covariances in every form that a file can have."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from refusals import is_refused
from scipy.spatial.transform import Rotation

from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.covariance_file import read_joint_covariance, write_joint_covariance
from trajeval_ros.io.npz_file import write_arrays
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.setting import (
    Setting,
    as_text,
    parse_lever,
    parse_noise,
    parse_recall,
    parse_score,
    parse_up,
)
from trajeval_ros.io.requests.settings_table import SETTINGS, settings_with
from trajeval_ros.metrics.score import KnotTable, PointTable, RecallRule

Array = NDArray[Any]


@pytest.mark.parametrize(
    ("text", "lever"),
    [
        ("none", None),
        ("0.4,0.2,1.0", (0.4, 0.2, 1.0)),
        ("-999.9, 999.9,0", (-999.9, 999.9, 0.0)),
        ("1000,0,0", "refused"),
        ("0,-1000,0", "refused"),
        ("0,0,nan", "refused"),
        ("0,0", "refused"),
        ("0,0,0,0", "refused"),
        ("", "refused"),
    ],
)
def test_a_lever_arm_is_three_numbers_below_a_kilometre(text: str, lever: Any) -> None:
    if lever == "refused":
        assert is_refused(parse_lever, text)
    else:
        assert parse_lever(text) == lever


@pytest.mark.parametrize(
    ("text", "noise"),
    [
        ("0.002,0.1", (0.002, 0.1)),
        ("1e-9, 1e9", (1e-9, 1e9)),
        ("0,0.1", None),
        ("0.1,0", None),
        ("-1,0.1", None),
        ("inf,0.1", None),
        ("0.1,inf", None),
        ("nan,0.1", None),
        ("0.1,nan", None),
        ("0.1", None),
        ("0.1,1,2", None),
    ],
)
def test_noise_is_two_numbers_above_zero(text: str, noise: Any) -> None:
    if noise is None:
        assert is_refused(parse_noise, text)
    else:
        assert parse_noise(text) == noise


def test_up_axes_are_one_or_two() -> None:
    assert parse_up("-y") == ("-y", "-y")
    assert parse_up("-y, z") == ("-y", "z")
    for wrong in ("w", "z,w", "z,z,z", ""):
        assert is_refused(parse_up, wrong)


@pytest.mark.parametrize(
    ("kind", "value", "found"),
    [
        (str, None, "none"),
        (str, [], "none"),
        (str, [8, 16.5, "x"], "8,16.5,x"),
        (str, 3, "3"),
        (str, True, "refused"),
        (str, [True], "refused"),
        (str, [[1]], "refused"),
        (str, {"a": 1}, "refused"),
        (float, 3, 3.0),
        (float, 2.5, 2.5),
        (float, True, "refused"),
        (float, "3", "refused"),
        (int, 3, 3),
        (int, 3.0, "refused"),
        (int, True, "refused"),
        (bool, True, True),
        (bool, 1, "refused"),
        (dict, {"a": 1}, {"a": 1}),
        (dict, None, None),
        (dict, 3, "refused"),
    ],
)
def test_values_of_yaml_have_the_type_of_their_setting(kind: type, value: Any, found: Any) -> None:
    setting = Setting(name="x", help="", kind=kind)
    if isinstance(found, str) and found == "refused":
        words = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}
        with pytest.raises(SettingsError, match=f"x must be {words.get(kind, 'a mapping')}, not"):
            setting.of_yaml(value)
        return
    assert setting.of_yaml(value) == found
    assert type(setting.of_yaml(value)) is type(found)


def test_defaults_are_written_as_on_the_command_line() -> None:
    for value, text in (
        ([8.0, 16.0], "8,16"),
        ([], "none"),
        (0.5, "0.5"),
        (1e-7, "1e-07"),
        ("8m", "8"),
        ("all", "all"),
        (3, "3"),
        (["8m", "10%"], "8,10%"),
    ):
        assert as_text(value) == text


def test_tables_of_points() -> None:
    table = {"bounds_m": [0.1, 1], "points": [10, 5.5], "best": 20, "dimensions": 2}
    found = parse_score(table)
    assert isinstance(found, PointTable)
    assert (found.bounds_m, found.points, found.best, found.dimensions) == (
        *((0.1, 1.0), (10.0, 5.5), 20.0, 2),
    )
    knots = parse_score({"knots_m": [0, 1], "points": [20, 5], "best": 20})
    assert isinstance(knots, KnotTable)
    assert knots.dimensions == 3
    default = parse_score({"bounds_m": [0.1], "points": [10]})
    assert isinstance(default, PointTable)
    assert (default.best, default.dimensions) == (PointTable.best, 3)
    recall = parse_recall({"bounds_m": [0.1, 0.2], "dimensions": 2})
    assert recall == RecallRule((0.1, 0.2), 2)
    assert parse_score(None) is parse_recall(None) is None
    for name, value in (
        ("points", 3),
        ("points", [True, 1]),
        ("points", ["1", 2]),
        ("points", [1e9, 5]),
        ("best", "x"),
        ("best", -1e9),
        ("dimensions", None),
        ("other", 1),
    ):
        assert is_refused(parse_score, {**table, name: value})
    assert is_refused(parse_recall, {"bounds_m": 1.0})
    assert is_refused(parse_recall, {"points": [1.0]})
    assert not is_refused(parse_score, {**table, "points": [0.99e9, 5.5], "best": 0.999e9})


@pytest.mark.parametrize(
    ("text", "limits"),
    [("0.5", (0.5, None)), ("0.5,2", (0.5, 2.0)), ("0.5,2,3", None), ("", None), ("x", None)],
)
def test_alert_limits_are_metres_and_degrees(text: str, limits: Any) -> None:
    settings = {"covariance": "message", "alert_limit": text, "gauge": "yaw"}
    if limits is None:
        assert is_refused(request_from, settings)
        return
    for risk, expected in ((None, 1e-3), (0.01, 0.01)):
        found = request_from({**settings, "risk": risk}).integrity
        assert found is not None
        assert (found.alert_limit_m, found.alert_limit_deg) == limits
        assert found.risk == (expected if risk else type(found).risk)


def test_settings_of_a_live_run_fill_in_defaults_that_are_not_of_the_protocol() -> None:
    request = request_from({"gauge": "yaw", "covariance": "message"})
    plain = settings_with(request, {})
    assert plain == {name: setting.of(request) for name, setting in SETTINGS.items()}
    stated = {"hand_eye": "x.yaml", "covariance": "none", "gauge": "se3", "deadline": 0.5}
    found = settings_with(request, stated)
    assert (found["hand_eye"], found["deadline"]) == ("x.yaml", 0.5)
    assert (found["covariance"], found["gauge"]) == (plain["covariance"], "yaw")
    assert settings_with(request, {"time_offset": "auto"})["time_offset"] == "auto"
    # It is of the protocol and of the calibration.
    assert settings_with(request, {"time_offset": "0.5"})["time_offset"] == "0.5"


def test_settings_that_do_not_exist_are_refused() -> None:
    with pytest.raises(SettingsError, match="gague"):
        request_from({"gague": "yaw"})
    assert request_from({"gauge": None}).protocol == request_from({}).protocol


def joint(seed: int, count: int, block: int = 6) -> JointCovariance:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(block * count, block * count))
    covariance = root @ root.T + np.eye(block * count)
    return JointCovariance(
        stamps=np.arange(count) * 10**8,
        positions=rng.normal(size=(count, 3)),
        quaternions=Rotation.random(count, random_state=seed).as_quat(),
        block=block,
        covariance=covariance,
        information=scipy.sparse.csr_matrix(np.linalg.inv(covariance)),
        gauge="prior",
    )


def dense(matrix: Any) -> Array:
    return np.asarray(matrix.toarray() if scipy.sparse.issparse(matrix) else matrix)


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), count=st.integers(1, 4), block=st.sampled_from([6, 9]))
def test_a_written_joint_covariance_is_read(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int, block: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "joint.npz"
    source = joint(seed, count, block)
    write_joint_covariance(path, source)
    found = read_joint_covariance(path)
    for name in ("stamps", "positions", "quaternions", "covariance"):
        np.testing.assert_array_equal(getattr(found, name), getattr(source, name), err_msg=name)
    np.testing.assert_array_equal(dense(found.information), dense(source.information))
    assert (found.block, found.gauge) == (block, "prior")


def arrays(source: JointCovariance, **changes: Any) -> dict[str, Any]:
    made = {
        "stamps_ns": source.stamps,
        "positions": source.positions,
        "quaternions": source.quaternions,
        "block": "p,phi" if source.block == 6 else "p,phi,v",
        "cov": source.covariance,
        **changes,
    }
    return {name: value for name, value in made.items() if value is not None}


@pytest.mark.parametrize("block", [6, 9])
@pytest.mark.parametrize("is_dense", [True, False])
def test_perturbations_on_the_right_are_turned(
    tmp_path: Path, block: int, *, is_dense: bool
) -> None:
    source, path = joint(3, 3, block), tmp_path / "x.npz"
    information = dense(source.information)
    sparse = scipy.sparse.csr_matrix(information)
    parts = {"info": information}
    if not is_dense:
        parts = {f"info_{name}": getattr(sparse, name) for name in ("data", "indices", "indptr")}
    write_arrays(path, arrays(source, perturbation="right", **parts))
    found = read_joint_covariance(path)
    turn = np.eye(3 * block)
    rotations = Rotation.from_quat(source.quaternions).as_matrix()
    for row, rotation in enumerate(rotations):
        begin = row * block + 3
        turn[begin : begin + 3, begin : begin + 3] = rotation
    assert source.covariance is not None
    assert found.covariance is not None
    np.testing.assert_allclose(found.covariance, turn @ source.covariance @ turn.T, rtol=1e-12)
    np.testing.assert_allclose(
        dense(found.information), turn @ information @ turn.T, rtol=1e-9, atol=1e-12
    )
    assert found.gauge == "unknown"
    write_arrays(path, arrays(source, perturbation="left", **parts))
    left = read_joint_covariance(path)
    assert left.covariance is not None
    np.testing.assert_array_equal(left.covariance, source.covariance)


BASE = joint(1, 2)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"stamps_ns": None, "block": None}, "has no stamps_ns, block"),
        ({"stamps_ns": np.array([0.0, 2.0**63])}, "are not all timestamps"),
        ({"stamps_ns": np.array([0.0, math.nan])}, "are not all timestamps"),
        ({"stamps_ns": np.array([0])}, "1 timestamp, positions of shape"),
        ({"stamps_ns": np.zeros(0), "positions": np.zeros((0, 3)),
            "quaternions": np.zeros((0, 4))}, "0 timestamps, positions"),
        ({"positions": np.zeros((2, 2))}, "their numbers must be equal"),
        ({"quaternions": np.zeros((2, 3))}, "their numbers must be equal"),
        ({"positions": np.array(["a", "b"])}, "positions has no numbers"),
        ({"cov": np.zeros(12)}, "cov is not a matrix"),
        ({"info": np.zeros(12), "cov": None}, "info is not a matrix"),
        ({"block": "x"}, "block is 'x'; use p,phi, p,phi,v"),
        ({"gauge": "x"}, "gauge is 'x'; use free, first4, prior, unknown"),
        ({"perturbation": "x"}, "perturbation is 'x'; use left, right"),
        ({"info_data": np.ones(1)}, "are not a 12 x 12 matrix in CSR format"),
        ({"info_data": np.ones(1), "info_indices": np.array([12]),
            "info_indptr": np.array([0, *[1] * 12])}, "are not a 12 x 12 matrix in CSR"),
    ],
)  # fmt: skip
def test_what_is_no_joint_covariance_is_refused(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    path = tmp_path / "x.npz"
    write_arrays(path, arrays(BASE, **changes))
    with pytest.raises(InputError, match=f"x.npz: .*{said}"):
        read_joint_covariance(path)


def test_timestamps_up_to_the_last_of_int64_are_read(tmp_path: Path) -> None:
    path, last = tmp_path / "x.npz", float(np.nextafter(2.0**63, 0.0))
    write_arrays(path, arrays(BASE, stamps_ns=np.array([-last, last])))
    assert read_joint_covariance(path).stamps.tolist() == [-int(last), int(last)]
    with pytest.raises(InputError, match="does not exist; check the path of --covariance"):
        read_joint_covariance(tmp_path / "none.npz")
