"""Records of evaluated runs: one that can't be used is evaluated anew."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.batch.records import Record, encode, read_record, write_record


@pytest.mark.parametrize(
    "changed",
    [
        {"shapes": 0.5},
        {"shapes": {"x": [0.5]}},
        {"shapes": {"x": 4}},
        {"span_ns": 3},
        {"span_ns": [1]},
        {"span_ns": ["a", "b"]},
        {"lengths": None},
        {"result": []},
        {"result": {"runs": []}},
        {"result": {"runs": "none"}},
    ],
)
def test_a_record_of_another_structure_is_none(tmp_path: Path, changed: dict[str, Any]) -> None:
    record = Record("key", {"runs": [{}]}, ("8m",), (0, 1), {"x": np.zeros((4, 3))})
    write_record(tmp_path, "key", encode(record))
    assert read_record(tmp_path, "key") is not None
    head, _, values = encode(record).partition(b"\n")
    odd = json.dumps({**json.loads(head), **changed}).encode()
    write_record(tmp_path, "key", odd + b"\n" + values)
    assert read_record(tmp_path, "key") is None
