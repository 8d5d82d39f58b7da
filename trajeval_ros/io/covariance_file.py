"""Reading and writing of joint covariances as npz archives (format: docs/consistency.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.consistency.joint_covariance import BLOCKS, JointCovariance
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.covariance_frames import world_from_body_rotations_jointly
from trajeval_ros.io.npz_file import read_arrays, write_arrays
from trajeval_ros.io.writing import write_whole

_ARRAYS = (
    "stamps_ns", "positions", "quaternions", "block", "perturbation", "gauge", "cov", "info",
    "info_data", "info_indices", "info_indptr",
)  # fmt: skip
_GAUGES = ("free", "first4", "prior", "unknown")
_LAST_NS = 2.0**63
_PERTURBATIONS = ("left", "right")


def write_joint_covariance(path: Path, joint: JointCovariance) -> None:
    """Write a joint covariance as an npz archive."""
    arrays: dict[str, Any] = {
        "stamps_ns": joint.stamps,
        "positions": joint.positions,
        "quaternions": joint.quaternions,
        "block": next(name for name, size in BLOCKS.items() if size == joint.block),
        "perturbation": "left",
        "gauge": joint.gauge,
    }
    if joint.covariance is not None:
        arrays["cov"] = joint.covariance
    if joint.information is not None:
        arrays["info_data"] = joint.information.data
        arrays["info_indices"] = joint.information.indices
        arrays["info_indptr"] = joint.information.indptr

    write_whole(path, lambda temporary: write_arrays(temporary, arrays))


def read_joint_covariance(path: Path) -> JointCovariance:
    """Read a joint covariance from an npz archive.

    A covariance with perturbations on the right is converted to perturbations on the left.
    """
    try:
        arrays = read_arrays(path, _ARRAYS)
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; check the path of --covariance") from None
    try:
        joint = _joint_of(arrays)
        joint.require_sound()
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return joint


def _joint_of(arrays: dict[str, NDArray[Any]]) -> JointCovariance:
    missing = [
        name for name in ("stamps_ns", "positions", "quaternions", "block") if name not in arrays
    ]
    if missing:
        raise InputError(f"the joint covariance has no {', '.join(missing)}")
    for name in set(arrays) - {"block", "perturbation", "gauge"}:
        if arrays[name].dtype.kind not in "iuf":
            raise InputError(f"the joint covariance's {name} has no numbers")
        if name in ("cov", "info") and arrays[name].ndim != 2:
            raise InputError(f"the joint covariance's {name} is not a matrix")
    if not (np.abs(arrays["stamps_ns"]) < _LAST_NS).all():  # also for NaN
        raise InputError("the joint covariance's stamps_ns are not all timestamps; correct them")
    stamps = np.asarray(arrays["stamps_ns"], dtype=np.int64).ravel()
    positions = np.asarray(arrays["positions"], dtype=np.float64)
    quaternions = np.asarray(arrays["quaternions"], dtype=np.float64)
    count = len(stamps)
    if positions.shape != (count, 3) or quaternions.shape != (count, 4) or not count:
        raise InputError(
            f"the joint covariance has {counted(count, 'timestamp')}, positions of shape "
            f"{positions.shape} and quaternions of shape {quaternions.shape}; their numbers "
            "must be equal"
        )
    block = BLOCKS.get(_word(arrays, "block", tuple(BLOCKS)))
    assert block is not None
    covariance = np.asarray(arrays["cov"], dtype=np.float64) if "cov" in arrays else None
    information = _information(arrays, count * block)
    if _word(arrays, "perturbation", _PERTURBATIONS) == "right":
        rotations = Rotation.from_quat(quaternions).as_matrix()
        covariance, information = world_from_body_rotations_jointly(
            covariance, information, rotations, block
        )
    return JointCovariance(
        stamps,
        positions,
        quaternions,
        block,
        covariance,
        information,
        _word(arrays, "gauge", _GAUGES),
    )


def _word(arrays: dict[str, NDArray[Any]], name: str, known: tuple[str, ...]) -> str:
    """Return a text of the archive; if it is missing, the default.

    The default is the first of `known`. For `gauge` it is the last one, `unknown`.
    """
    word = str(arrays[name]) if name in arrays else known[0 if name != "gauge" else -1]
    if word not in known:
        raise InputError(f"the joint covariance's {name} is {word!r}; use {', '.join(known)}")
    return word


def _information(arrays: dict[str, NDArray[Any]], size: int) -> scipy.sparse.csr_matrix | None:
    if "info" in arrays:
        return scipy.sparse.csr_matrix(np.asarray(arrays["info"], dtype=np.float64))
    if "info_data" not in arrays:
        return None
    try:
        parts = tuple(arrays[f"info_{name}"] for name in ("data", "indices", "indptr"))
        matrix = scipy.sparse.csr_matrix(parts, shape=(size, size))
        matrix.check_format(full_check=True)  # wrong indices would read outside of the arrays
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"info_data, info_indices and info_indptr are not a {size} x {size} matrix in CSR "
            "format"
        ) from error
    return matrix
