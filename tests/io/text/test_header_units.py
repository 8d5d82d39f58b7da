"""Timestamps in two columns, as ROS has them, and units of positions in names of columns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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
    with pytest.raises(
        InputError, match=r"row 3 has .* in column nanosec, expected 0 to 999999999"
    ):
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
    [
        ("x [ft],y [ft],z [ft]", "unit of 'x .ft.', 'ft', is unknown"),
        ("x_ft,y_ft,z_ft", "unit of 'x_ft', 'ft', is unknown"),
        ("x_mm,y_mm,z_m", "its positions are in mm and m, not all in m,"),
        ("x [mm],y,z", "its positions are in mm and m, not all in m,"),
        ("lat [rad],lon [rad],alt", "unit of 'lat .rad.', 'rad', is unknown"),
        ("lat,lon,alt [mm]", "unit of 'alt .mm.', 'mm', is unknown"),
    ],
)
def test_other_units_are_refused(names: str, unit: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", f"t_ns,{names}", STAMPS)
    with pytest.raises(InputError, match=rf"a\.csv: .*{unit}"):
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


@pytest.mark.parametrize(
    ("name", "per_second"),
    [
        *((name, 1000) for name in ("ms", "timems", "time/ms", "t_ms", "time (milliseconds)")),
        *((name, 1000) for name in ("milli_time", "ms_stamp", "time_ms_since_start")),
        *((name, 10**6) for name in ("micros", "time [µs]", "time_us", "time in us")),
    ],
)
def test_units_of_times_from_zero(name: str, per_second: int, tmp_path: Path) -> None:
    """Only the name tells the unit of a clock that starts at zero."""
    times = [0, 50, 99, 151]
    read = read_trajectory(written(tmp_path / "a.csv", f"{name},x,y,z", times))
    assert read.stamps.tolist() == [time * 10**9 // per_second for time in times]


def test_the_option_for_a_time_has_its_unit(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", "since_ms,x,y,z", [0, 50, 99, 151])
    with pytest.raises(InputError, match="--columns 't_ms x y z'"):
        read_trajectory(path)


@pytest.mark.parametrize("comment", ["# in millimetres", "# position, wxyz", "# angles in deg"])
@pytest.mark.parametrize("names", ["", "t,x,y,z,qx,qy,qz,qw\n"])
def test_a_comment_about_a_unit_is_told(comment: str, names: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{comment}\n{names}1.5,1,2,3,0,0,0,1\n2.5,1,3,3,0,0,0,1\n")
    remarks = [remark.text for remark in read_trajectory(path).reading.remarks]
    assert any(f"a comment is not read: {comment!r}" in text for text in remarks)


@pytest.mark.parametrize(
    "name",
    ["{} mm", "{}  [millimetre]", "{}  in mm", "{} _millimeters", "mm_{}", "imu_mm_pos_{}"],
)
def test_units_of_positions(name: str, tmp_path: Path) -> None:
    names = ",".join(map(name.format, "xyz"))
    read = read_trajectory(written(tmp_path / "a.csv", f"t_ns,{names}", STAMPS))
    np.testing.assert_allclose(read.positions, 1e-3 * POSITIONS)


@pytest.mark.parametrize("name", ["deg_{}", "imu_deg_{}", "{}_in_deg"])
def test_units_of_angles(name: str, tmp_path: Path) -> None:
    names = ",".join(map(name.format, ("roll", "pitch", "yaw")))
    path = written(tmp_path / "a.csv", f"{names},x,y,z", [1] * 4, [2] * 4, [3] * 4)
    angles = Rotation.from_quat(read_trajectory(path).known_quaternions).as_euler("ZYX", True)
    np.testing.assert_allclose(angles, [[3, 2, 1]] * 4)


WEEK_S = 604_800


@pytest.mark.parametrize(
    ("names", "first_s", "per_second", "weeks_s"),
    [
        ("week,tow", 200_000.25, 1, 0),
        ("gps_week,gps_sow", 7.5, 1, 0),
        ("WN,iTOW", 7.5, 1000, 0),
        ("week,tow", 200_000.25, 1000, 0),
        ("Week,GPSTime", WEEK_S - 2.5, 1, 2345 * WEEK_S),  # the week changes
    ],
)
def test_times_of_the_week_of_gps(
    names: str, first_s: float, per_second: int, weeks_s: int, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    pairs = [divmod(first_s + row, WEEK_S) for row in range(9)]
    lines = [f"{2345 + week:.0f},{per_second * time:.10g},{time},2,3" for week, time in pairs]
    path.write_text("\n".join([f"{names},x,y,z", *lines]))
    stamps_s = [weeks_s + first_s + row for row in range(9)]
    assert (read_trajectory(path).stamps / 1e9).tolist() == stamps_s
    path.write_text("\n".join([f"{names},x,y,z", *lines, f"-1,{lines[0][5:]}"]))
    with pytest.raises(InputError, match="row 10 has -1 in column week, expected 0 to 9999"):
        read_trajectory(path)


def test_rtklib_has_one_name_for_week_and_time(tmp_path: Path) -> None:
    path = tmp_path / "a.pos"
    lines = [f"2345 {200_000 + row}.25 47.{row} 8.5 400 1" for row in range(1, 9)]
    path.write_text("\n".join(["%  GPST  latitude(deg) longitude(deg) height(m) Q", *lines]))
    assert read_trajectory(path).stamps[:2].tolist() == [200_001_250_000_000, 200_002_250_000_000]


@pytest.mark.parametrize(
    ("names", "digits"), [("sec,usec", 6), ("time_s,time_ms", 3), ("seconds,nanoseconds", 9)]
)
def test_parts_of_seconds_in_other_units(names: str, digits: int, tmp_path: Path) -> None:
    step = 10 ** (9 - digits)
    parts = [part // step for part in NANOSECONDS]
    read = read_trajectory(written(tmp_path / "a.csv", f"{names},x,y,z", SECONDS, parts))
    assert read.stamps.tolist() == [stamp // step * step for stamp in STAMPS]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("t;x;y;z\n1.5;0,1;0,2;0,3\n2.5;0,1;0,2;0,3\n", "decimal commas and points"),
        ("t;x;y;z\n1,5;1.234,5;0,2;0,3\n2,5;1.235,5;0,2;0,3\n", "decimal commas and points"),
        ("t;x;y;z\n1;1'234.5;2;3\n2;1'235.5;2;3\n", r"column 2 \(x\): .* is not a number"),
    ],
)
def test_separators_of_thousands_are_refused(text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=problem):
        read_trajectory(path)


def test_degrees_in_another_encoding(tmp_path: Path) -> None:
    text = "t,x,y,z,roll [°],pitch [°],yaw [°]\n1,0,0,0,1,2,3\n2,1,0,0,1,2,3\n"
    paths = [tmp_path / name for name in ("utf-8", "latin-1", "utf-16")]
    for path in paths:
        path.write_text(text, encoding=path.name)
    first, *others = (read_trajectory(path).known_quaternions for path in paths)
    angles = Rotation.from_quat(first).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(angles, [[3, 2, 1]] * 2)
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_a_position_in_two_units_is_read_once(tmp_path: Path) -> None:
    names = ",".join(f"{axis} [{unit}]" for unit in ("mm", "m") for axis in "xyz")
    path = written(tmp_path / "a.csv", f"time [s],{names}", range(4), *(1000.0 * POSITIONS).T)
    np.testing.assert_array_equal(read_trajectory(path).positions, POSITIONS)


def test_a_word_in_place_of_a_time_is_refused_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", "time,x,y,z", ["early", "late", "later", "last"])
    with pytest.raises(InputError, match=r"line 2: column 1 has 'early', .* --columns '_ x y z'"):
        read_trajectory(path)
