"""Written text has the characters that Python gives numbers, and is read as the same numbers."""

from __future__ import annotations

import tempfile
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.save_trajectories import (
    _integers,
    _rows_of_floats,
    _seconds,
    write_euroc,
    write_tum,
)
from trajeval_ros.io.sources import read_trajectory

stamps = arrays.arrays(np.int64, st.integers(1, 30), elements=st.integers(-(2**63), 2**63 - 1))


@given(stamps)
def test_integers_are_exact(numbers: np.ndarray) -> None:
    assert _integers(numbers.tolist()) == [str(number) for number in numbers.tolist()]


@given(stamps)
def test_seconds_keep_every_nanosecond(numbers: np.ndarray) -> None:
    written = _seconds(numbers.tolist())
    assert [Decimal(word) * 10**9 for word in written] == numbers.tolist()
    assert {len(word.partition(".")[2]) for word in written} == {9}


@given(
    arrays.arrays(
        np.float64,
        st.tuples(st.integers(1, 8), st.integers(1, 8)),
        elements=st.floats(allow_nan=False, allow_infinity=False)
        | st.floats(-1e17, 1e17)
        | st.floats(-1e-3, 1e-3),
    ),
    st.sampled_from([" ", ","]),
)
def test_lines_have_the_floats_as_repr_writes_them(rows: np.ndarray, separator: str) -> None:
    expected = [separator.join(map(repr, row)) for row in rows.tolist()]
    assert _rows_of_floats(rows, separator) == expected
    assert _rows_of_floats(np.asfortranarray(rows), separator) == expected


@pytest.mark.parametrize("exponent", [-5, -4, -3, 0, 14, 15, 16, 17])
def test_floats_at_the_borders_of_exponents(exponent: int) -> None:
    border = 10.0**exponent
    rows = np.array([[np.nextafter(border, 0.0), border, np.nextafter(border, np.inf), -border]])
    assert _rows_of_floats(rows, " ") == [" ".join(map(repr, rows[0].tolist()))]


@given(
    arrays.arrays(np.float64, (5, 3), elements=st.floats(-1e12, 1e12)),
    st.lists(st.integers(10**18, 2 * 10**18), min_size=5, max_size=5, unique=True),
    st.sampled_from([write_tum, write_euroc]),
)
def test_what_is_written_is_read_as_the_same_numbers(
    positions: np.ndarray, times: list[int], write: object
) -> None:
    assert callable(write)
    quaternions = np.array([[1.0, -2.0, 3.0, 0.1 * row] for row in range(5)])
    written = Trajectory.from_columns(np.array(sorted(times)), positions, quaternions)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.txt"
        write(path, written)
        read = read_trajectory(str(path))
    for name in ("stamps", "positions", "quaternions"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
