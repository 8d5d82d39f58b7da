"""Fixes in text files: named columns, and NMEA."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from fix_runs import DATUM
from nmea import PLACES, POSITIONS, gga, sentence

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.geodesy import east_north_up
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory


@pytest.mark.parametrize("separator", [",", " "])
@pytest.mark.parametrize(
    "names", [("lat", "lon", "alt"), ("latitude", "longitude", "height"), ("Lat[deg]", "Lng", "h")]
)
def test_named_columns(names: tuple[str, str, str], separator: str, tmp_path: Path) -> None:
    file = tmp_path / "fixes.csv"
    rows = [
        separator.join(
            [f"1700000000.{row:03d}", *(repr(float(x)) for x in place), "0.01", "0.02", "0.03"]
        )
        for row, place in enumerate(PLACES)
    ]
    header = separator.join(["time", *names, "sigma_e", "sigma_n", "sigma_u"])
    file.write_text("\n".join([header, *rows]))
    result = read_trajectory(file)
    assert (result.kind, result.reading.format) == ("gnss", "latitude, longitude, height")
    assert result.reading.fixes is not None
    np.testing.assert_array_equal(result.reading.fixes.places, PLACES)
    np.testing.assert_array_equal(result.stamps, 1_700_000_000 * 10**9 + np.arange(30) * 10**6)
    np.testing.assert_allclose(result.reading.fixes.sigma_level_m, 0.02)
    np.testing.assert_allclose(result.reading.fixes.sigma_up_m, 0.03)


def test_columns_without_height_and_with_status(tmp_path: Path) -> None:
    file = tmp_path / "fixes.txt"
    rows = [
        f"{row} {latitude!r} {longitude!r} {row % 3 - 1}"
        for row, (latitude, longitude, _) in enumerate(PLACES.tolist())
    ]
    file.write_text("# t latitude longitude status\n" + "\n".join(rows))
    result = read_trajectory(file)
    assert result.reading.fixes is not None
    assert result.reading.format == "latitude, longitude"
    assert not result.reading.fixes.have_heights
    assert result.reading.dropped == {"no_fix": 10}


def test_nmea(tmp_path: Path) -> None:
    file = tmp_path / "log.nmea"
    begin = datetime(2024, 3, 31, 23, 59, 50, tzinfo=timezone.utc).timestamp()
    lines = []
    for row, place in enumerate(PLACES):
        lines.append(gga(begin + row + 0.25, place))
        if row == 4:
            lines.append(sentence("GNRMC,235954.25,A,4724.0,N,00830.0,E,0.1,77.0,310324,,,R"))
        lines.append("$GNGSA,A,3,01*00")
    lines[6] = lines[6][:30] + "9" + lines[6][31:]  # a bit that fell over
    file.write_text("\r\n".join(lines))
    result = read_trajectory(file)
    kept = np.arange(30) != 3
    assert result.reading.dropped == {"undecodable": 1}
    expected = int(begin) * 10**9 + np.arange(30) * 10**9 + 250_000_000
    np.testing.assert_array_equal(result.stamps, expected[kept])
    assert result.reading.fixes is not None
    np.testing.assert_allclose(
        east_north_up(result.reading.fixes.places, DATUM), POSITIONS[kept], rtol=0, atol=2e-4
    )
    assert set(result.reading.fixes.status.tolist()) == {2}
    assert not result.reading.fixes.known.any()


@pytest.mark.parametrize(
    ("quality", "status"), [(0, None), (1, 0), (2, 1), (4, 2), (5, 2), (6, None)]
)
def test_nmea_s_quality(quality: int, status: int | None, tmp_path: Path) -> None:
    file = tmp_path / "log.txt"
    file.write_text("\n".join(gga(100.0 + row, PLACES[row], quality) for row in range(5)))
    if status is None:
        with pytest.raises(InputError, match="5 no fix"):
            read_trajectory(file)
        return
    result = read_trajectory(file)
    assert result.reading.fixes is not None
    assert set(result.reading.fixes.status.tolist()) == {status}
    assert any("1970-01-01" in note for note in result.reading.messages(Level.NOTE))


def test_southern_and_western_places(tmp_path: Path) -> None:
    file = tmp_path / "log.txt"
    places = PLACES * [-1.0, -1.0, 1.0]
    file.write_text("\n".join(gga(row, place) for row, place in enumerate(places)))
    result = read_trajectory(file)
    assert result.reading.fixes is not None
    np.testing.assert_allclose(
        result.reading.fixes.places[:, :2], places[:, :2], rtol=0, atol=1e-9
    )


def test_an_nmea_file_without_a_whole_line(tmp_path: Path) -> None:
    file = tmp_path / "log.txt"
    file.write_text("$GPGGA,,,,,,0,,,,,,,,*66\n" * 3)
    with pytest.raises(InputError, match="no complete fix in 3 GGA lines"):
        read_trajectory(file)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_line_end_of_nmea_is_read(end: str, tmp_path: Path) -> None:
    file = tmp_path / "log.nmea"
    file.write_bytes(end.join(gga(row, place) for row, place in enumerate(PLACES)).encode())
    assert len(read_trajectory(file)) == len(PLACES)


@pytest.mark.parametrize(
    "wrong",
    [
        sentence("GPRMC,000001,A,4724.0,N,00830.0,E,0.1,77.0,000000,,,A"),  # no such day
        sentence("GPRMC,000001,A,4724.0,N,00830.0,E,0.1,77.0,310224,,,A"),
        sentence("GPZDA,000001,32,01,2024,00,00"),
        sentence("GPZDA,000001,01,01,0000,00,00"),
        sentence("GPRMC,000001,V,,,,,,,060180,,,N"),  # before a fix, the receiver's own epoch
        sentence("GPRMC,000001,A,4724.0,N,00830.0,E,0.1,77.0,010203,,,A")[:-1] + "x",
        sentence("GPRMC,000001,A,4724.0,N,00830.0,E,0.1,77.0,010203,,,A").replace("47", "48"),
        "$GPRMC,000001,A",  # cut off; the fields of the next lines are not its own
        "$GPRMC,000001,A,4724.0,N,00830.0,E",
    ],
)
def test_a_line_without_a_valid_date_is_passed_over(wrong: str, tmp_path: Path) -> None:
    file = tmp_path / "log.nmea"
    lines = [wrong, *(gga(row, place) for row, place in enumerate(PLACES[:5]))]
    file.write_text("\n".join(lines))
    undated = read_trajectory(file)
    assert undated.stamps[0] == 0
    assert any("1970-01-01" in note for note in undated.reading.messages(Level.NOTE))
    file.write_text("\n".join([*lines, sentence("GPZDA,000004,05,06,2025,00,00")]))
    day = int(datetime(2025, 6, 5, tzinfo=timezone.utc).timestamp())
    np.testing.assert_array_equal(read_trajectory(file).stamps, (day + np.arange(5)) * 10**9)


@pytest.mark.parametrize("height", ["1.2.3", "-", ".", ""])
def test_a_height_that_is_no_number_is_dropped(height: str, tmp_path: Path) -> None:
    file = tmp_path / "log.nmea"
    odd = sentence(f"GPGGA,000009,4724.0,N,00830.0,E,4,12,0.7,{height},M,47.2,M,,")
    lines = [gga(row, place) for row, place in enumerate(PLACES[:5])]
    file.write_text("\n".join([*lines, odd]))
    assert read_trajectory(file).reading.dropped == {"undecodable": 1}
    file.write_text("\n".join([*lines, odd.replace("47.2", "1.2.3")]))
    assert read_trajectory(file).reading.dropped == {"undecodable": 1}


def fixes_in(path: Path, *lines: str) -> Trajectory:
    path.write_text("\n".join(lines) + "\n")
    return read_trajectory(path)


def test_a_status_of_fixes_that_is_missing_is_no_fix(tmp_path: Path) -> None:
    rows = [f"{row},47.0,8.{row},400.0,{'' if row == 2 else row % 3}" for row in range(6)]
    result = fixes_in(tmp_path / "x.csv", "time,latitude,longitude,height,status", *rows)
    assert result.reading.dropped == {"no_fix": 1}
    assert result.reading.fixes is not None
    assert result.reading.fixes.status.tolist() == [0, 1, 0, 1, 2]


@pytest.mark.parametrize("sent", ["RMC", "ZDA"])
@pytest.mark.parametrize("place", [0, 1, 3, 4, 6])
@pytest.mark.parametrize("second", [50, 53, 56])
def test_days_of_nmea_follow_from_the_line_with_a_date(
    tmp_path: Path, sent: str, place: int, second: int
) -> None:
    """Midnight is between any of the lines; the date is of the line before or after it."""
    begin = int(datetime(2023, 12, 31, 23, 59, second, tzinfo=timezone.utc).timestamp())
    lines = [gga(begin + 2 * row, PLACES[row]) for row in range(6)]
    stamp = begin + max(2 * place - 1, 0)
    at = datetime.fromtimestamp(stamp, tz=timezone.utc)
    dated = f"GNZDA,{at:%H%M%S}.00,{at:%d,%m,%Y},00,00"
    if sent == "RMC":
        dated = f"GNRMC,{at:%H%M%S}.00,A,4724.0,N,00830.0,E,0.1,77.0,{at:%d%m%y},,,R"
    lines.insert(place, sentence(dated))
    result = fixes_in(tmp_path / "x.nmea", *lines)
    assert result.stamps.tolist() == [(begin + 2 * row) * 10**9 for row in range(6)]
    assert not result.reading.messages(Level.NOTE)[1:]


@pytest.mark.parametrize(("step", "days"), [(43_200, 0), (43_201, 1)])
def test_half_a_day_back_is_the_next_day(tmp_path: Path, step: int, days: int) -> None:
    lines = [gga(86_399 - step * row, PLACES[row]) for row in range(2)]
    result = fixes_in(tmp_path / "x.nmea", *lines)
    assert result.stamps.tolist() == [86_399 * 10**9, (86_399 - step + days * 86_400) * 10**9]


@pytest.mark.parametrize(("sent", "day"), [("113001", 2), ("113000", 1)])
def test_a_date_half_a_day_back_is_of_the_next_day(tmp_path: Path, sent: str, day: int) -> None:
    """The fixes are of 23:30:01; the line with the date is half a day earlier or later."""
    lines = [gga(84_600 + row, PLACES[row]) for row in range(2)]
    dated = sentence(f"GNZDA,{sent}.00,02,01,1980,00,00")
    result = fixes_in(tmp_path / "x.nmea", *lines, dated)
    begin = int(datetime(1980, 1, day, 23, 30, tzinfo=timezone.utc).timestamp())
    assert result.stamps.tolist() == [begin * 10**9, (begin + 1) * 10**9]


@pytest.mark.parametrize(
    ("digits", "nanoseconds"),
    [("", 0), (".5", 500_000_000), (".000000001", 1), (".1234567899", 123_456_789)],
)
def test_fractions_of_seconds_of_nmea(tmp_path: Path, digits: str, nanoseconds: int) -> None:
    body = f"GNGGA,010203{digits},4724.60,N,00830.30,E,4,12,0.7,400.5,M,47.25,M,1.0,0001"
    result = fixes_in(
        tmp_path / "x.nmea",
        sentence(body),
        sentence(body.replace("010203", "010204").replace("24.60", "24.61")),
    )
    assert result.stamps[0] == 3723 * 10**9 + nanoseconds
    assert result.reading.fixes is not None
    np.testing.assert_allclose(result.reading.fixes.places[0], [47.41, 8.505, 447.75], rtol=1e-14)
    bare = body.replace("47.25,M", ",M")  # without the separation, the altitude is the height
    result = fixes_in(tmp_path / "x.nmea", sentence(bare))
    assert result.reading.fixes is not None
    assert result.reading.fixes.places[0, 2] == 400.5
