"""Values of settings, and joint covariances in every form that a file can have."""

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
    parse_noise,
    parse_up,
)
from trajeval_ros.io.requests.settings_table import SETTINGS, settings_with

Array = NDArray[Any]


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


def test_settings_of_a_live_run_fill_in_defaults_that_are_not_of_the_protocol() -> None:
    request = request_from({"gauge": "yaw", "covariance": "message"})
    plain = settings_with(request, {})
    assert plain == {name: setting.of(request) for name, setting in SETTINGS.items()}
    stated = {"hand_eye": "x.yaml", "covariance": "none", "gauge": "se3", "deadline": 0.5}
    result = settings_with(request, stated)
    assert (result["hand_eye"], result["deadline"]) == ("x.yaml", 0.5)
    assert (result["covariance"], result["gauge"]) == (plain["covariance"], "yaw")
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
    result = read_joint_covariance(path)
    for name in ("stamps", "positions", "quaternions", "covariance"):
        np.testing.assert_array_equal(getattr(result, name), getattr(source, name), err_msg=name)
    np.testing.assert_array_equal(dense(result.information), dense(source.information))
    assert (result.block, result.gauge) == (block, "prior")


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
    result = read_joint_covariance(path)
    rotation_step = np.eye(3 * block)
    rotations = Rotation.from_quat(source.quaternions).as_matrix()
    for row, rotation in enumerate(rotations):
        begin = row * block + 3
        rotation_step[begin : begin + 3, begin : begin + 3] = rotation
    assert source.covariance is not None
    assert result.covariance is not None
    np.testing.assert_allclose(
        result.covariance, rotation_step @ source.covariance @ rotation_step.T, rtol=1e-12
    )
    np.testing.assert_allclose(
        dense(result.information),
        rotation_step @ information @ rotation_step.T,
        rtol=1e-9,
        atol=1e-12,
    )
    assert result.gauge == "unknown"
    write_arrays(path, arrays(source, perturbation="left", **parts))
    left = read_joint_covariance(path)
    assert left.covariance is not None
    np.testing.assert_array_equal(left.covariance, source.covariance)


BASE = joint(1, 2)


@pytest.mark.parametrize(
    ("changes", "message"),
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
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = tmp_path / "x.npz"
    write_arrays(path, arrays(BASE, **changes))
    with pytest.raises(InputError, match=f"x.npz: .*{message}"):
        read_joint_covariance(path)


def test_timestamps_up_to_the_last_of_int64_are_read(tmp_path: Path) -> None:
    path, last = tmp_path / "x.npz", float(np.nextafter(2.0**63, 0.0))
    write_arrays(path, arrays(BASE, stamps_ns=np.array([-last, last])))
    assert read_joint_covariance(path).stamps.tolist() == [-int(last), int(last)]
    with pytest.raises(InputError, match="does not exist; check the path of --covariance"):
        read_joint_covariance(tmp_path / "none.npz")
