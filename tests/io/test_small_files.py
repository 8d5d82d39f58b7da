"""Small files, names and checks of readers: what is written is read."""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import is_refused
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.checks import check_rotations, require_known
from trajeval_ros.io.hand_eye_file import (
    hand_eye_json,
    hand_eye_of,
    read_hand_eye,
    read_similarity,
)
from trajeval_ros.io.json_file import json_text, mapping_in, require_schema
from trajeval_ros.io.npz_file import read_arrays, write_arrays
from trajeval_ros.io.yaml_file import read_mapping


def test_the_largest_deviation_of_a_length_is_told() -> None:
    quaternions = np.tile([0.6, 0.0, 0.0, 0.8], (5, 1))
    quaternions[1:4] *= np.array([[1.5], [0.25], [1.6]])
    quaternions[4] *= 1e-7  # no length, which is counted elsewhere
    _, [remark] = check_rotations(quaternions)
    assert remark.text == "3 quaternions normalised, largest deviation: length 0.25"
    quaternions[3] *= 1.5
    _, [remark] = check_rotations(quaternions)
    assert remark.text.endswith("length 2.4")
    barely = np.array([[0.6, 0.0, 0.0, 0.8], [0.0, 0.0, 0.0, 1.01e-6]])
    assert len(check_rotations(barely)[1]) == 1
    barely[1, 3] = 0.99e-6
    assert check_rotations(barely)[1] == ()


def test_rotations_that_are_all_the_identity_are_none() -> None:
    identities = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    result, [remark] = check_rotations(identities)
    assert (result, remark.code) == (None, "identity_rotations")
    assert remark.text.startswith("all rotations are the identity")
    _, [remark] = check_rotations(0.0 * identities)
    assert remark.text.startswith("all rotations have zero quaternions")
    alone = identities[:1]
    assert check_rotations(alone) == (alone, ())
    for column in range(3):
        rotated = identities.copy()
        rotated[1, column] = 1e-3
        assert check_rotations(rotated) == (rotated, ())
    assert check_rotations(None)[1][0].code == "no_rotations"


@settings(max_examples=8)
@given(
    st.lists(st.floats(-100, 100), min_size=3, max_size=3),
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.floats(1e-3, 1e3),
)
def test_a_written_transform_is_read(
    tmp_path_factory: pytest.TempPathFactory, lever: list[float], turn: list[float], scale: float
) -> None:
    pose = HandEye.of(np.array(turn), np.array(lever))
    pose = HandEye(pose.rotation_xyzw, pose.lever_m, "base", "marker")
    path = tmp_path_factory.getbasetemp() / "pose.yaml"
    path.write_text(json.dumps(hand_eye_json(pose)))
    result = read_hand_eye(path)
    np.testing.assert_array_equal(result.lever_m, lever)
    np.testing.assert_allclose(result.rotation_xyzw, pose.rotation_xyzw, rtol=1e-15)
    assert (result.body, result.marker) == ("base", "marker")
    plain = read_similarity(path)
    path.write_text(json.dumps({**hand_eye_json(pose), "scale": scale}))
    scaled = read_similarity(path)
    assert (plain.scale, scaled.scale) == (1.0, scale)
    for item in (plain, scaled):
        np.testing.assert_array_equal(item.translation, lever)
        expected = Rotation.from_rotvec(turn).as_matrix()
        np.testing.assert_allclose(item.rotation, expected, atol=1e-14)


def transform(**changes: Any) -> dict[str, Any]:
    """Return a transform's mapping; `x_x=5` changes `translation.x`, `r_w=5` `rotation.w`."""
    numbers = {"x_x": 1, "x_y": 2.5, "x_z": 3, "r_x": 0, "r_y": 0, "r_z": 0.6, "r_w": 0.8}
    numbers |= changes
    parts = {"x": "translation", "r": "rotation"}
    made: dict[str, Any] = {"translation": {}, "rotation": {}}
    for name, value in numbers.items():
        made[parts[name[0]]][name[2:]] = value
    return {"transform": made}


def test_a_transform_without_names_or_parts() -> None:
    result = hand_eye_of({**transform(), "header": {"stamp": {}}}, "t")
    assert (result.body, result.marker) == ("", "")
    np.testing.assert_array_equal(result.lever_m, [1.0, 2.5, 3.0])
    np.testing.assert_allclose(result.rotation_xyzw, [0.0, 0.0, 0.6, 0.8], rtol=1e-15)
    for wrong in (
        {"header": 3},
        {"transform": None},
        {"transform": {"translation": {"x": 1, "y": 2, "z": 3}}},
        {"pose": {}},
        {"header": {"frame": "a"}},
    ):
        with pytest.raises(InputError, match=r"t.*(missing|unknown)"):
            hand_eye_of({**transform(), **wrong}, "t")


@pytest.mark.parametrize(
    ("number", "refused"),
    [(2**64 - 1, False), (2**64, True), (-(2**64) + 1, False), (-(2**64), True)],
)
def test_integers_of_yaml_have_64_bits(tmp_path: Path, number: int, *, refused: bool) -> None:
    path = tmp_path / "x.yaml"
    for text in (f"a: {number}", f"a: [1, {{b: {number}}}]", f"a: {{{number}: 1}}"):
        path.write_text(text)
        assert is_refused(read_mapping, path, "thing") == refused


def test_yaml_is_the_first_mapping(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    for text, result in (
        ("a: 0.20\n---\nb: 1", {"a": 0.2}),
        ("%YAML:1.0\n---\na: 2", {"a": 2}),
        ("a: no", {"a": "no"}),
    ):
        path.write_text(text)
        assert read_mapping(path, "thing") == result
    path.write_text("a: 0.20")
    assert read_mapping(path, "thing", as_text=True) == {"a": "0.20"}
    for text, message in (
        ("- a", "has no thing"),
        ("1: a", "has no thing"),
        ("", "has no thing"),
        ("a: [1\nb: 2\nc: ]", "not valid YAML in line 2"),
        ("a: {ours: vio/{sequence}.txt}", "write patterns with braces in quotes"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_mapping(path, "thing")
    path.write_text('a: {ours: "vio", x: [}')
    with pytest.raises(InputError) as raised:
        read_mapping(path, "thing")
    assert "braces" not in str(raised.value)
    path.write_bytes(b"a: \xff")
    assert is_refused(read_mapping, path, "thing")
    assert is_refused(read_mapping, tmp_path / "none.yaml", "thing")


def test_a_wrong_name_is_answered_by_the_nearest_or_by_all() -> None:
    known = ["position", "rotation"]
    require_known(["rotation"], known, "t")
    with pytest.raises(
        InputError, match=r"t has an unknown key 'rotatoin'; did you mean rotation"
    ):
        require_known(["position", "rotatoin"], known, "t")
    with pytest.raises(InputError, match="unknown word 'x'; use one of position, rotation"):
        require_known(["x"], known, "t", "word")
    # A similarity of 0.65 is near: 2 * 13 of 40 characters.
    with pytest.raises(InputError, match="did you mean"):
        require_known(["a" * 13 + "b" * 7], ["a" * 13 + "c" * 7], "t")
    with pytest.raises(InputError, match="use one of"):
        require_known(["a" * 12 + "b" * 8], ["a" * 12 + "c" * 8], "t")


@given(st.dictionaries(st.text(max_size=5), st.floats(allow_nan=False, allow_infinity=False)))
def test_json_is_read_as_it_is_written(values: dict[str, float]) -> None:
    assert mapping_in(json_text(values)) == values
    text = json_text(values, 2)
    assert text.endswith("}\n")
    assert mapping_in(text.encode()) == values


@pytest.mark.parametrize(
    ("text", "is_read"),
    [
        (f'{{"a": {2**63 - 1}}}', True),
        (f'{{"a": {2**63}}}', False),
        (f'{{"a": {-(2**63)}}}', True),
        (f'{{"a": {-(2**63) - 1}}}', False),
        ('{"a": 1e308}', True),
        ('{"a": 1e309}', False),
        ('{"a": NaN}', False),
        ('{"a": -Infinity}', False),
        ("[1]", False),
        ("{", False),
        ("[" * 100_000, False),
    ],
)
def test_numbers_of_json_are_int64_or_float64(text: str, *, is_read: bool) -> None:
    assert (mapping_in(text) is not None) == is_read
    with pytest.raises(ValueError, match="JSON"):
        json_text({"a": math.nan})


def test_schemas_of_other_versions_are_told_from_other_files() -> None:
    require_schema(Path("x"), "trajeval/2", "trajeval/2", "result", "do it again")
    with pytest.raises(InputError, match=r"x has schema trajeval/1, and this version reads"):
        require_schema(Path("x"), "trajeval/1", "trajeval/2", "result", "do it again")
    for other in ("trajeval-pairs/2", "trajeval", None, 3):
        with pytest.raises(InputError, match=r"x is not a result \(trajeval/2\); do it again"):
            require_schema(Path("x"), other, "trajeval/2", "result", "do it again")


@pytest.mark.parametrize("compressed", [False, True])
def test_written_arrays_are_read(tmp_path: Path, *, compressed: bool) -> None:
    path = tmp_path / "x.npz"
    rng = np.random.default_rng(0)
    arrays = {"a": rng.normal(size=(3, 4)), "b": np.arange(5), "word": "left", "none": np.empty(0)}
    write_arrays(path, arrays, compressed=compressed)
    result = read_arrays(path, ("a", "word", "none", "missing"))
    assert set(result) == {"a", "word", "none"}
    for name, array in result.items():
        np.testing.assert_array_equal(array, arrays[name])


def test_what_is_no_plain_array_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    write_arrays(path, {"a": np.array([None])})
    assert is_refused(read_arrays, path, ("a",))
    path.write_bytes(b"PK no archive")
    assert is_refused(read_arrays, path, ("a",))
    with zipfile.ZipFile(path, "w") as archive:
        whole = tmp_path / "a.npy"
        np.save(whole, np.arange(4))
        archive.writestr("a.npy", whole.read_bytes() + b"more")
    with pytest.raises(InputError, match="a is not a plain array, or its size is wrong"):
        read_arrays(path, ("a",))


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"r_z": 1.2, "r_w": 1.6}, "has length 2 and is not a unit quaternion"),
        ({"x_x": 1e15}, "translation.x must be a number"),
        ({"x_z": "3"}, "translation.z must be a number"),
        ({"r_v": 1}, "unknown"),
        ({"scale": 0}, "scale must be a number greater than zero"),
        ({"scale": "1"}, "scale must be a number greater than zero"),
    ],
)
def test_numbers_of_a_transform(tmp_path: Path, changes: dict[str, Any], part: str) -> None:
    path = tmp_path / "t.yaml"
    scale = {"scale": changes.pop("scale", 2)}
    path.write_text(json.dumps({**transform(**changes), **scale}))
    with pytest.raises(InputError, match=part):
        read_similarity(path)


def test_a_large_file_of_yaml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: 1\n" + "#" * 10_000_000)
    with pytest.raises(InputError, match=r"larger than .*, the limit for YAML"):
        read_mapping(path, "thing")
