"""Timestamps in two columns, as ROS has them, and units of positions in names of columns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.sources import read_trajectory

# With no, few and all digits of nanoseconds; float64 seconds cannot have the first two.
STAMPS = [1403636580_838555574, 1403636580_900000001, 1403636581_000000000, 1403636581_000000042]
POSITIONS = np.array([[1.0, 2.0, 3.0], [1.5, 2.0, -3.25], [2.0, 2.5, 3.125], [0.0, 0.5, 0.25]])


def written(path: Path, header: str, *columns: object) -> Path:
    rows = zip(*columns, POSITIONS.tolist(), strict=True)  # type: ignore[call-overload]
    lines = [",".join(map(str, [*parts, *position])) for *parts, position in rows]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


SECONDS, NANOSECONDS = zip(*(divmod(stamp, 10**9) for stamp in STAMPS), strict=True)
LATER = [f"{second + 7}.25" for second in SECONDS]


@pytest.mark.parametrize(
    "names",
    ["header.stamp.sec,header.stamp.nanosec", "stamp_secs,stamp_nsecs", "secs,nsecs", "sec,nsec"],
)
def test_seconds_and_nanoseconds_are_one_timestamp(names: str, tmp_path: Path) -> None:
    both = written(tmp_path / "a.csv", f"{names},x,y,z", SECONDS, NANOSECONDS)
    assert read_trajectory(both).stamps.tolist() == STAMPS
    first, second = names.split(",")
    other = written(tmp_path / "b.csv", f"{second},{first},x,y,z", NANOSECONDS, SECONDS)
    assert read_trajectory(other).stamps.tolist() == STAMPS


@pytest.mark.parametrize("before", ["Time", "receive_time", "elapsed,receive_time"])
def test_the_time_of_the_header_precedes_that_of_the_arrival(before: str, tmp_path: Path) -> None:
    names = f"{before},header.stamp.secs,header.stamp.nsecs,position.x,position.y,position.z"
    times = [LATER] * len(before.split(","))
    read = read_trajectory(written(tmp_path / "a.csv", names, *times, SECONDS, NANOSECONDS))
    assert read.stamps.tolist() == STAMPS
    received = read.reading.receive_times
    assert (received is not None) == ("receive_time" in before)
    if received is not None:
        assert received.times.tolist() == [int(item[:-3]) * 10**9 + 250_000_000 for item in LATER]


def test_messages_as_json_lines(tmp_path: Path) -> None:
    path = tmp_path / "messages.jsonl"
    parts = {"sec": SECONDS, "nanosec": NANOSECONDS}
    lines = [
        json.dumps(
            {
                "header": {"stamp": {name: part[row] for name, part in parts.items()}},
                "pose": {"position": dict(zip("xyz", POSITIONS[row].tolist(), strict=True))},
            }
        )
        for row in range(len(STAMPS))
    ]
    path.write_text("\n".join(lines))
    assert read_trajectory(path).stamps.tolist() == STAMPS


@pytest.mark.parametrize("wrong", [10**9, -1, 0.5, "nan"])
def test_parts_that_are_no_nanoseconds_are_refused(wrong: object, tmp_path: Path) -> None:
    parts = [*NANOSECONDS[:2], wrong, 0]
    path = written(tmp_path / "a.csv", "sec,nanosec,x,y,z", SECONDS, parts)
    with pytest.raises(InputError, match=r"row 3 has .* nanoseconds .* expected 0 to 999999999"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("km", 1e3), ("", 1.0)]
)
@pytest.mark.parametrize("form", ["{}_{}", "{} [{}]", "{}[{}]", "pos_{} ({})"])
def test_positions_are_in_the_unit_that_their_names_have(
    form: str, unit: str, metres: float, tmp_path: Path
) -> None:
    names = ",".join(form.format(axis, unit).removesuffix("_") for axis in "xyz")
    read = read_trajectory(written(tmp_path / "a.csv", f"t_ns,{names}", STAMPS))
    np.testing.assert_array_equal(read.positions, POSITIONS * metres)
    text = [remark.text for remark in read.reading.remarks if remark.code == "unit"]
    assert text == ([f"positions converted from {unit} to m"] if metres != 1.0 else [])


@pytest.mark.parametrize(
    ("names", "unit"),
    [("x [ft],y [ft],z [ft]", "ft"), ("x_mm,y_mm,z_m", "mm and m"), ("x [mm],y,z", "mm and m")],
)
def test_other_units_are_refused(names: str, unit: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", f"t_ns,{names}", STAMPS)
    with pytest.raises(InputError, match=rf"a\.csv: its positions are in {unit}, not all in m,"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("unit", "is_read"),
    [("m/s", True), ("m s^-1", True), ("mm/s", False), ("cm s^-1", False), ("km/h", False)],
)
def test_velocities_in_other_units_are_ignored(unit: str, is_read: bool, tmp_path: Path) -> None:
    names = ",".join(f"v{axis} [{unit}]" for axis in "xyz")
    read = read_trajectory(
        written(tmp_path / "a.csv", f"t_ns,x,y,z,{names}", STAMPS, *POSITIONS.T)
    )
    assert (read.velocities is not None) == is_read
    text = [remark.text for remark in read.reading.remarks if "ignored" in remark.text]
    assert text == ([] if is_read else [f"ignored columns: {names.replace(',', ', ')}"])


def test_a_column_without_a_name_is_named_by_its_place(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", ",t_ns,x,y,z", range(4), STAMPS)
    assert "ignored columns: column 1" in [
        remark.text for remark in read_trajectory(path).reading.remarks
    ]
