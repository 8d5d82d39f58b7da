"""Any mapping in YAML is read or refused in one sentence."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.bag_folder import read_metadata
from trajeval_ros.io.hand_eye_file import read_hand_eye, read_similarity
from trajeval_ros.io.yaml_file import read_mapping

NUMBERS = st.one_of(
    st.integers().map(str),
    st.floats().map(repr),
    st.integers(1, 6000).map(lambda count: "0x" + "f" * count),
    st.integers(1, 6000).map(lambda count: "-0o" + "7" * count),
    st.integers(1, 6000).map(lambda count: "9" * count),
    st.sampled_from([".inf", "-.nan", "1e999", "1_0", "1:2:3", "null", "yes", "[]", "{}", "''"]),
)
HAND_EYE = """
transform:
  translation: {{x: {0}, y: 0, z: {1}}}
  rotation: {{x: 0, y: {0}, z: 0, w: 1}}
"""
METADATA = """
rosbag2_bagfile_information:
  relative_file_paths: []
  topics_with_message_count:
  - topic_metadata: {{name: /a, type: {0}}}
    message_count: {1}
"""


def said_by(read: Callable[[Path], object], path: Path) -> str:
    try:
        read(path)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.slow
@given(NUMBERS, NUMBERS)
@example("0x" + "f" * 6000, "1")
@example("1", "0x" + "f" * 6000)
@example("9" * 6000, "1")
@example("1", "{")
def test_any_number_is_read_or_refused_in_a_sentence(first: str, second: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.yaml"
        for text, readers in (
            (HAND_EYE, (read_hand_eye,)),
            (f"{HAND_EYE}scale: {{1}}", (read_similarity,)),
            (METADATA, (read_metadata,)),
        ):
            path.write_text(text.format(first, second))
            for read in readers:
                assert "\n" not in said_by(read, path)


def test_numbers_of_an_anchor_are_examined_once(tmp_path: Path) -> None:
    levels = [f"l{index}: &l{index} [{f'*l{index - 1}, ' * 9}]" for index in range(1, 30)]
    path = tmp_path / "x.yaml"
    path.write_text("\n".join(["l0: &l0 [1]", *levels]))
    assert len(read_mapping(path, "numbers")) == 30
    path.write_text("\n".join(["l0: &l0 [0xfffffffffffffffffff]", *levels]))
    with pytest.raises(InputError, match="integer of more than 64 bits"):
        read_mapping(path, "numbers")


@pytest.mark.parametrize("is_generated", [False, True])
def test_a_file_of_many_elements_is_refused(is_generated: bool, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(f"a: [{'1,' * 250_000}]")
    with pytest.raises(InputError, match="lines and elements"):
        read_mapping(path, "numbers", is_generated=is_generated)
