"""Numbers of rows and frames of text and arrays, and files of their times."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path
from typing import Any

import pytest
from refusals import is_refused

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import TextHints

SECOND = 10**9


def read(path: Path, *lines: str, **hints: Any) -> Trajectory:
    path.write_text("\n".join(lines) + "\n")
    return read_trajectory(path, hints=TextHints(**hints))


def text(result: Trajectory) -> str:
    return "; ".join(result.reading.messages(Level.NOTE))


def test_rows_without_times_are_counted_by_a_rate(tmp_path: Path) -> None:
    rows = [f"{row}.0 0 0 0 0 0 1" for row in range(4)]
    result = read(tmp_path / "x.txt", *rows, frame_rate_hz=30.0)
    assert result.stamps.tolist() == [0, 33_333_333, 66_666_667, 100_000_000]
    assert result.reading.stamped
    assert "timestamps counted at 30 Hz" in text(result)
    bare = read(tmp_path / "x.txt", *rows)
    assert bare.stamps.tolist() == [0, SECOND, 2 * SECOND, 3 * SECOND]
    assert not bare.reading.stamped
    assert "frames counted, 1 s apart" in text(bare)
    for rate in (0.0, -1.0, math.inf, math.nan):
        assert is_refused(TextHints, frame_rate_hz=rate)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_a_file_of_times_has_one_per_row(tmp_path: Path, count: int) -> None:
    (tmp_path / "times.txt").write_text("".join(f"{10 + row}.5\n" for row in range(count)))
    rows = ["1 0 0 0 0 1 0 0 0 0 1 0"] * 4
    result = read(tmp_path / "x.txt", *rows)
    if count == 4:
        assert result.stamps.tolist() == [10_500_000_000 + row * SECOND for row in range(4)]
        assert "timestamps read from" in text(result)
    else:
        assert not result.reading.stamped
        assert f"times.txt ignored: it has {count} rows for 4 poses" in text(result)
    (tmp_path / "times.txt").write_text("0\n33\n67\n100\n")
    with pytest.raises(InputError, match=r"steps of 33, seconds or milliseconds; .* sed -i") as no:
        read_trajectory(tmp_path / "x.txt")
    command = str(no.value).partition("above them: ")[2].partition(" (or")[0]
    subprocess.run(["bash", "-c", command], check=True)
    stamps = read_trajectory(tmp_path / "x.txt").stamps.tolist()
    assert stamps == [0, 33_000_000, 67_000_000, 100_000_000]
    (tmp_path / "times.txt").write_text("1 2\n3 4\n")
    with pytest.raises(InputError, match="has 2 columns, expected one time per line"):
        read_trajectory(tmp_path / "x.txt")


@pytest.mark.parametrize(
    ("numbers", "counts"),
    [
        ((0, 1, 2), True),
        ((3, 5, 7), True),
        ((0, 1, 2, 4), False),
        ((2, 1, 0), False),
        ((0.5, 1.5, 2.5), False),
        ((1, 1, 1), False),
    ],
)
def test_whole_numbers_in_equal_steps_count_the_rows_of_a_file_of_times(
    tmp_path: Path, numbers: tuple[float, ...], *, counts: bool
) -> None:
    (tmp_path / "times.txt").write_text("".join(f"{100 + row}.5\n" for row in range(9)))
    rows = [f"{number} {row} 0 0 0 0 0 1" for row, number in enumerate(numbers)]
    if numbers == (1, 1, 1):
        assert is_refused(read, tmp_path / "x.txt", *rows)
        return
    result = read(tmp_path / "x.txt", *rows)
    assert result.reading.numbered == counts
    if counts:
        expected = [100_500_000_000 + int(number) * SECOND for number in numbers]
        assert result.stamps.tolist() == expected


@pytest.mark.parametrize(
    ("first", "last", "row_of_0"),
    [(0, 8, 0), (0, 9, None), (1, 9, -1), (3, 9, -1), (2, 8, 0), (2, 10, None), (1, 8, "1 or 0")],
)
def test_frames_are_counted_from_1_if_the_last_one_is_the_number_of_times(
    tmp_path: Path, first: int, last: int, row_of_0: int | str | None
) -> None:
    (tmp_path / "times.txt").write_text("".join(f"{100 + row}.5\n" for row in range(9)))
    numbers = range(first, last + 1)
    rows = [f"{number} {number} 0 0 0 0 0 1" for number in numbers]
    if row_of_0 == "1 or 0":
        with pytest.raises(InputError, match=r"start at 1, and .*times.txt has 9 times"):
            read(tmp_path / "x.txt", *rows)
        return
    result = read(tmp_path / "x.txt", *rows)
    assert ("frame numbers start at 1" in text(result)) == (row_of_0 == -1)
    assert ("times.txt ignored: it has 9 rows" in text(result)) == (row_of_0 is None)
    if isinstance(row_of_0, int):
        expected = [100_500_000_000 + (number + row_of_0) * SECOND for number in numbers]
        assert result.stamps.tolist() == expected


@pytest.mark.parametrize("number", ["-1", "1.5"])
def test_frame_numbers_are_whole(tmp_path: Path, number: str) -> None:
    with pytest.raises(InputError, match=r"row 2 has no frame number in column 1"):
        read(tmp_path / "x.csv", "frame,x,y,z", "0,1,2,3", f"{number},2,3,4")
