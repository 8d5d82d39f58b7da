"""Files of numpy and JSON lines, and text with semicolons: layouts, times and refusals."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text import reader
from trajeval_ros.io.text.hints import SideHints
from trajeval_ros.io.text.reader import read_text
from trajeval_ros.simulation.drifting_odometry import simulate

FLIGHT = simulate(seed=5, duration_s=20.0).estimate


def matrices() -> np.ndarray:
    result = np.tile(np.eye(4), (len(FLIGHT), 1, 1))
    assert FLIGHT.quaternions is not None
    result[:, :3, :3] = lie.to_matrix(FLIGHT.quaternions)
    result[:, :3, 3] = FLIGHT.positions
    return result


def rows() -> np.ndarray:
    return np.column_stack([FLIGHT.positions, FLIGHT.quaternions])


def saved(path: Path, array: np.ndarray) -> Path:
    np.save(path, array)
    return path


def assert_same(read: Trajectory, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(read.positions, FLIGHT.positions, rtol=0, atol=atol)
    assert read.quaternions is not None
    assert FLIGHT.quaternions is not None
    same = np.abs(np.einsum("ni,ni->n", read.quaternions, FLIGHT.quaternions))
    np.testing.assert_allclose(same, 1.0, rtol=0, atol=atol)


@pytest.mark.parametrize("shape", [(4, 4), (3, 4), (16,), (12,)])
def test_matrices_of_numpy(tmp_path: Path, shape: tuple[int, ...]) -> None:
    array = matrices()
    if shape in ((3, 4), (12,)):
        array = array[:, :3]
    read = read_trajectory(saved(tmp_path / "run_poses.npy", array.reshape(-1, *shape)))
    assert_same(read)
    assert not read.reading.stamped
    assert read.up.name == "z"  # unlike KITTI's text


def test_rows_of_numpy_with_times(tmp_path: Path) -> None:
    timed = np.column_stack([FLIGHT.stamps / 1e9, rows()])
    read = read_trajectory(saved(tmp_path / "timed.npy", timed))
    assert_same(read)
    assert np.abs(read.stamps - FLIGHT.stamps).max() < 500
    in_ns = np.column_stack([FLIGHT.stamps.astype(float), rows()])
    assert (
        np.abs(read_trajectory(saved(tmp_path / "ns.npy", in_ns)).stamps - FLIGHT.stamps).max()
        < 500
    )


def test_times_next_to_an_array(tmp_path: Path) -> None:
    path = saved(tmp_path / "poses_hall.npy", rows().astype(np.float32))
    saved(tmp_path / "tstamps_hall.npy", FLIGHT.stamps)
    read = read_trajectory(path)
    assert_same(read, 1e-5)
    assert np.abs(read.stamps - FLIGHT.stamps).max() <= 128  # read as float64
    assert any("tstamps_hall.npy" in remark.text for remark in read.reading.remarks)
    saved(tmp_path / "tstamps_hall.npy", np.arange(len(FLIGHT)) * 2.0)  # numbers of images
    read = read_trajectory(path)
    assert not read.reading.stamped
    assert read.reading.frame_numbers is not None
    assert read.reading.frame_numbers[:3].tolist() == [0, 2, 4]
    saved(tmp_path / "tstamps_hall.npy", FLIGHT.stamps[:-1])
    with pytest.raises(InputError, match="give one time per pose"):
        read_trajectory(path)


def test_columns_of_an_array_can_be_named(tmp_path: Path) -> None:
    wxyz = np.column_stack(
        [FLIGHT.stamps / 1e9, FLIGHT.positions, np.roll(rows()[:, 3:], 1, axis=1)]
    )
    path = saved(tmp_path / "wxyz.npy", wxyz)
    read = read_trajectory(path, hints=SideHints.of("t x y z qw qx qy qz", None).estimate)
    assert_same(read)
    read = read_trajectory(path, hints=SideHints.of("t x y z", None).estimate)
    np.testing.assert_array_equal(read.positions, FLIGHT.positions)
    with pytest.raises(InputError, match=r"shape \(\d+, 8\), and --columns names 9 columns"):
        read_trajectory(path, hints=SideHints.of("t x y z qw qx qy qz received", None).estimate)
    with pytest.raises(InputError, match="has numbers, and no dates"):
        read_trajectory(path, hints=SideHints.of("date x y z", None).estimate)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((5, 9)), r"has shape \(5, 9\); supported"),
        (np.zeros((0, 8)), r"has shape \(0, 8\)"),
        (np.zeros(8), r"has shape \(8,\)"),
        (np.ones((5, 7), dtype=complex), "values of type complex128"),
        (np.array([{"x": 1}]), "not a readable array of numpy"),
        (np.ones((5, 4, 4)), "matrix 0 has no rotation"),
        (np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (5, 1, 1)), "matrix 0 has no rotation"),
        (np.arange(35.0).reshape(5, 7), "unclear which of the 7 columns are the quaternion"),
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, array: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_trajectory(saved(tmp_path / "array.npy", array))


def test_a_wrong_last_row_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"matrix 1 has the last row .* expected 0 0 0 1"):
        read_trajectory(saved(tmp_path / "array.npy", np.swapaxes(matrices(), 1, 2)))


def test_json_lines(tmp_path: Path) -> None:
    assert FLIGHT.quaternions is not None
    lines = [
        json.dumps(
            {
                "time": stamp / 1e9,
                "position": dict(zip("xyz", place, strict=True)),
                "orientation": dict(zip("xyzw", rotation, strict=True)),
                "status": "TRACKING",
            }
        )
        for stamp, place, rotation in zip(
            FLIGHT.stamps.tolist(),
            FLIGHT.positions.tolist(),
            FLIGHT.quaternions.tolist(),
            strict=True,
        )
    ]
    lost = json.dumps({"time": 1.0, "position": {"x": 0, "y": 0, "z": 0}, "status": "LOST"})
    path = tmp_path / "run.jsonl"
    path.write_text("\n".join([*lines, lost, '{"time": 2.0, "event": "loop"}']) + "\n")
    read = read_trajectory(path)
    assert_same(read)
    assert np.abs(read.stamps - FLIGHT.stamps).max() < 500
    assert read.reading.dropped["no_position_or_not_tracking"] == 2
    numbered = [line.replace('"TRACKING"', "1") for line in lines]  # a code of another program
    path.write_text("\n".join(numbered) + "\n")
    assert_same(read_trajectory(path))
    path.write_text('{"time": 1.0, "x": 1.0}\n{"time"\n')
    with pytest.raises(InputError, match="line 2: no JSON object"):
        read_trajectory(path)
    path.write_text('{"time": 1.0, "x": 1.0}\n\n\n{"time"\n')
    with pytest.raises(InputError, match="line 4: no JSON object"):
        read_trajectory(path)
    path.write_text('{"time": 1.0, "x": 1.0}\n')
    with pytest.raises(InputError, match="position"):
        read_trajectory(path)
    path.write_text('{"a":' * 3000 + "1" + "}" * 3000)
    with pytest.raises(InputError, match="is not valid JSON: its objects are nested too deeply"):
        read_trajectory(path)
    path.write_text('[{"time": 1.0},\n{"time" 2.0}]')
    with pytest.raises(InputError, match=r"is not valid JSON: .* line 2 column 9"):
        read_trajectory(path)


@pytest.mark.slow
def test_an_archive_of_endless_zeros_is_refused(tmp_path: Path) -> None:
    path, begin = tmp_path / "run.npz", io.BytesIO()
    form = {"descr": "<f8", "fortran_order": False, "shape": (9 * 2**20, 8)}
    np.lib.format.write_array_header_1_0(begin, form)
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("poses.npy", "w") as file,
    ):
        file.write(begin.getvalue())
        for _ in range(9):
            file.write(bytes(2**26))
    with pytest.raises(InputError, match="poses has a compression ratio above 500"):
        read_trajectory(path)


def test_semicolons_without_a_header(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table = np.column_stack([FLIGHT.stamps / 1e9, rows()])
    np.savetxt(path, table, fmt="%.12f", delimiter=";")
    assert_same(read_trajectory(path), 1e-9)


def test_a_picture_is_called_a_picture(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR")
    with pytest.raises(InputError, match=r"is a picture \(PNG\)"):
        read_trajectory(path)


@pytest.mark.parametrize("kind", [TypeError, AttributeError, struct.error, AssertionError])
def test_an_exception_of_a_library_becomes_a_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise kind("broken inside")

    path = tmp_path / "a.txt"
    path.write_text("1.5 1 2 3 0 0 0 1\n2.5 1 2 3 0 0 0 1\n")
    monkeypatch.setattr(reader, "_read", fail)
    with pytest.raises(InputError, match=r"a\.txt can't be read by the reader of text.*broken"):
        read_text(path)


def test_results_of_evo_are_named(tmp_path: Path) -> None:
    path = tmp_path / "ape.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("info.json", "stats.json", "error_array.npy"):
            archive.writestr(name, "{}")
    with pytest.raises(InputError, match="has the errors of evo, and no poses; give the traject"):
        read_trajectory(path)


def test_times_in_text_next_to_an_array_are_exact(tmp_path: Path) -> None:
    np.save(tmp_path / "poses.npy", np.tile(np.eye(4), (3, 1, 1)))
    stamps = [1_700_000_000_123_456_789 + 10**8 * row for row in range(3)]
    lines = (f"{stamp // 10**9}.{stamp % 10**9:09d}\n" for stamp in stamps)
    (tmp_path / "times.txt").write_text("".join(lines))
    assert read_trajectory(tmp_path / "poses.npy").stamps.tolist() == stamps
