"""Reading of the pose of a marker in the body: a `geometry_msgs/TransformStamped` in YAML.

    header: {frame_id: base_link}
    child_frame_id: marker
    transform:
      translation: {x: 0.1, y: -0.05, z: 0.2}
      rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}

The names of the frames are optional. The output of `ros2 topic echo --once` of a topic with this
type is a valid file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.io.checks import require_known
from trajeval_ros.io.yaml_file import read_mapping

_WHAT = "transform"
_UNIT = 0.01  # tolerance of a quaternion's length, for rounded digits


def read_hand_eye(path: Path) -> HandEye:
    """Read T_B_M; `header.frame_id` is the estimate's body, `child_frame_id` the marker."""
    message = read_mapping(path, _WHAT)
    return hand_eye_of(message, str(path))


def read_similarity(path: Path) -> Similarity:
    """Read a transformation from a file of the same format, with an optional field `scale`."""
    message = read_mapping(path, _WHAT)
    scale = message.pop("scale", 1.0)
    if type(scale) not in (int, float) or not 0.0 < scale <= LARGEST:
        raise InputError(f"{path}: scale must be a number greater than zero, not {scale!r}")
    rigid = hand_eye_of(message, str(path))
    return Similarity(lie.to_matrix(rigid.rotation_xyzw), rigid.lever_m, float(scale))


def hand_eye_of(message: dict[str, Any], path: str) -> HandEye:
    """Return T_B_M from the mapping in a file."""
    require_known(message, ("header", "child_frame_id", "transform"), path)
    header = _mapping(message.get("header", {}), f"{path}: header")
    require_known(header, ("stamp", "frame_id", "seq"), f"{path}: header")
    transform = _mapping(message.get("transform"), f"{path}: transform")
    require_known(transform, ("translation", "rotation"), f"{path}: transform")
    lever_m = _numbers(transform.get("translation"), "xyz", f"{path}: transform.translation")
    quaternion = _numbers(transform.get("rotation"), "xyzw", f"{path}: transform.rotation")
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > _UNIT:
        raise InputError(
            f"{path}: transform.rotation has length {length:.3g} and is not a unit quaternion; "
            "give x, y, z, w"
        )
    return HandEye(
        quaternion / length,
        lever_m,
        str(header.get("frame_id") or ""),
        str(message.get("child_frame_id") or ""),
    )


def hand_eye_json(hand_eye: HandEye) -> dict[str, Any]:
    """Return the transform as the mapping that such a file contains."""
    return {
        "header": {"frame_id": hand_eye.body},
        "child_frame_id": hand_eye.marker,
        "transform": {
            "translation": dict(zip("xyz", hand_eye.lever_m.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", hand_eye.rotation_xyzw.tolist(), strict=True)),
        },
    }


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(
            f"{where} is missing or not a mapping; write it as in geometry_msgs/TransformStamped"
        )
    return value


def _numbers(value: Any, names: str, where: str) -> Any:
    values = _mapping(value, where)
    require_known(values, names, where)
    numbers: list[float] = []
    for name in names:
        number = values.get(name)
        if isinstance(number, (int, float)) and abs(number) <= LARGEST:
            numbers.append(float(number))
        else:
            raise InputError(f"{where}.{name} must be a number, not {number!r}")
    return np.array(numbers)
