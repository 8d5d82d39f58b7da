"""Columns that a file does not explain: refused with a command that works, or stated first."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import SideHints

COUNT = 200
TIMES = 0.1 * np.arange(COUNT)
COURSE = 0.012 * TIMES**2 + 0.4 * np.sin(TIMES)
STEPS = 0.1 * np.stack([np.cos(COURSE), np.sin(COURSE), 0.1 * np.sin(3 * TIMES)], axis=1)
PLACES = np.cumsum(STEPS, axis=0) - STEPS
XYZW = Rotation.from_euler("z", COURSE[:, None]).as_quat()
WRAPPED = (COURSE + np.pi) % (2.0 * np.pi) - np.pi


def write(path: Path, *columns: object, header: str = "") -> Path:
    table = np.column_stack([np.asarray(column) for column in columns])
    np.savetxt(path, table, fmt="%.12g", header=header, comments="")
    return path


@pytest.mark.parametrize(
    ("columns", "header", "right"),
    [
        ((100 * np.arange(COUNT), PLACES, XYZW), "", "t_ms x y z qx qy qz qw"),
        ((100 * np.arange(COUNT), PLACES), "time x y z", "t_ms x y z"),
        ((20_000 * np.arange(COUNT), PLACES), "time x y z", "t_us x y z"),
        ((TIMES, PLACES[:, :2], WRAPPED), "", "t x y yaw"),
        ((TIMES, PLACES[:, :2], np.degrees(WRAPPED) % 360.0), "", "t x y yaw_deg"),
        ((TIMES, PLACES[:, :2], COURSE), "", "t x y yaw"),
        ((TIMES, PLACES[:, :2], np.degrees(WRAPPED)), "", "t x y yaw_deg"),
        ((TIMES, PLACES[:, :2] * 0.0, WRAPPED), "", "t x y yaw"),
    ],
)
def test_what_has_two_meanings_is_refused_with_an_option_that_works(
    tmp_path: Path, columns: tuple[np.ndarray, ...], header: str, right: str
) -> None:
    path = write(tmp_path / "t.txt", *columns, header=header)
    with pytest.raises(InputError) as refusal:
        read_trajectory(path)
    option = re.findall(r"--columns '([^']*)'", str(refusal.value))[0]
    assert option == right
    result = read_trajectory(path, hints=SideHints.of(option, None).estimate)
    unit = {"t_ms": 10**6, "t_us": 10**3}.get(option.split()[0], 10**9)
    assert result.stamps.tolist() == np.round(columns[0] * unit).astype(np.int64).tolist()
    if "yaw" in option:
        error = Rotation.from_quat(result.quaternions).inv() * Rotation.from_euler(
            "z", COURSE[:, None]
        )
        assert error.magnitude().max() < 1e-6
        assert not result.positions[:, 2].any()


@pytest.mark.parametrize(
    ("columns", "header", "stated"),
    [
        ((TIMES, PLACES), "", "4 columns read as t x y z"),
        ((TIMES, STEPS), "", "4 columns read as t x y z"),
        ((np.arange(COUNT), PLACES), "time x y z", "in steps of 1, are assumed to be seconds"),
        ((45_000 + np.arange(COUNT), PLACES, XYZW), "", "in steps of 1, are assumed"),
        ((1e3 * TIMES + 0.25, PLACES), "time x y z", "in steps of 1e+02, are assumed"),
        ((TIMES / 86_400.0, PLACES), "time x y z", "in steps of 1.2e-06, are assumed"),
    ],
)
def test_what_cannot_be_decided_is_stated_above_the_tables(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    columns: tuple[np.ndarray, ...],
    header: str,
    stated: str,
) -> None:
    path = write(tmp_path / "t.txt", *columns, header=header)
    assert main(["evaluate", str(path), str(path)]) == 0
    captured = capsys.readouterr()
    assert stated in captured.out.partition("Absolute trajectory error")[0]
    assert stated not in captured.err
    assert main(["groundtruth", str(path)]) == 0
    assert stated in capsys.readouterr().out


def test_whole_numbers_can_be_frames(tmp_path: Path) -> None:
    path = write(tmp_path / "t.txt", 3 * np.arange(COUNT), PLACES, XYZW)
    with pytest.raises(InputError, match="frame"):
        read_trajectory(path)
    result = read_trajectory(path, hints=SideHints.of("frame x y z qx qy qz qw", 30.0).estimate)
    assert result.stamps.tolist() == [10**8 * row for row in range(COUNT)]


@pytest.mark.parametrize("sign", ["#", "%"])
def test_comments_between_rows_change_no_number(tmp_path: Path, sign: str) -> None:
    path = write(tmp_path / "t.txt", TIMES, PLACES, XYZW, header="t x y z qx qy qz qw")
    plain = read_trajectory(path)
    lines = path.read_text().splitlines()
    lines[50] += f" {sign} the end of a row"
    lines[10:10] = [f"{sign} restart", "", f"  {sign}1 2 3 4 5 6 7 8"]
    path.write_text("\n".join(lines))
    commented = read_trajectory(path)
    assert commented.stamps.tolist() == plain.stamps.tolist()
    assert commented.positions.tobytes() == plain.positions.tobytes()
    lines[20:20] = [f"{sign} t x y z qw qx qy qz"]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="line 21: a comment names other columns"):
        read_trajectory(path)


NAMES = ["timestamp", "tx", "ty", "tz", "qw", "qx", "qy", "qz"]


@pytest.mark.parametrize(
    "lines",
    [
        [f"# {name}" for name in NAMES],
        ["# Trajectory of a robot", *(f"# {name}" for name in NAMES), "#"],
        [f"# {at}: {name}" for at, name in enumerate(NAMES, 1)],
        [f"% column {at} - {name}" for at, name in enumerate(NAMES)],
        ["# Columns:", *(f"#   {at}) {name} - of the body" for at, name in enumerate(NAMES))],
        NAMES,
    ],
)
def test_names_on_lines_of_their_own_are_a_header(tmp_path: Path, lines: list[str]) -> None:
    rows = TIMES, PLACES, XYZW[:, [3, 0, 1, 2]]
    result = read_trajectory(write(tmp_path / "t.txt", *rows, header="\n".join(lines)))
    np.testing.assert_allclose(np.abs(np.sum(result.quaternions * XYZW, axis=1)), 1.0, rtol=1e-9)
    np.testing.assert_allclose(result.positions, PLACES, atol=1e-9)


def test_velocities_on_lines_of_their_own_are_no_positions(tmp_path: Path) -> None:
    path = write(tmp_path / "t.txt", TIMES, STEPS, header="# timestamp\n# vx\n# vy\n# vz")
    with pytest.raises(InputError, match="no column has a name of a position"):
        read_trajectory(path)
    header = "# timestamp\n# tx\n# ty\n# tz\n# qw"
    path = write(tmp_path / "t.txt", TIMES, PLACES, XYZW, header=header)
    with pytest.raises(InputError, match="its header names 5 columns"):
        read_trajectory(path)
