"""The live picture between real processes: nobody waits, and no viewer takes the file with it.

Viewers are stood in for by Rerun's own program without a window: it receives as a viewer does.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.viewer.sinks import sinks_for
from trajeval_ros.visual_inertial.drifting_odometry import simulate

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")

from rerun_driver import flight_at
from rrd import Rrd

ROOT = Path(__file__).resolve().parent.parent
DRIVER = Path(__file__).with_name("rerun_driver.py")
NAME = "vio_odometry"
FRAME = f"world/estimate/{NAME}"
PATIENCE_S = 240.0
# A tick comes every 50 ms. Whoever waits for a viewer waits for seconds, or for ever.
WAITED_S = 0.5


@pytest.fixture
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def url(port: int) -> str:
    return f"rerun+http://127.0.0.1:{port}/proxy"


def environment() -> dict[str, str]:
    # CI keeps Rerun's programs from calling home.
    return {**os.environ, "CI": "1", "PYTHONPATH": str(ROOT)}


@contextmanager
def rerun(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run Rerun's program."""
    import rerun_cli

    program = Path(rerun_cli.__file__).with_name("rerun")
    with subprocess.Popen(
        [str(program), *arguments],
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGCONT)
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()


def receiver(port: int, file: Path) -> Any:
    """Listen as a viewer does, and keep what comes in a file."""
    return rerun("--bind", "127.0.0.1", "--port", str(port), "--save", str(file))


def drive(
    value: str, folder: Path, seconds: float = 30.0, speed: float = 3.0, place: str = "0,0,0"
) -> Any:
    """Begin to draw a flight in a process of its own."""
    return subprocess.Popen(
        [sys.executable, str(DRIVER), value, str(folder), str(seconds), str(speed), place],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def told(process: Any) -> dict[str, Any]:
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    report: dict[str, Any] = json.loads(out.splitlines()[-1])
    assert report["longest_wait_s"] < WAITED_S
    return report


def assert_whole(file: Path, report: dict[str, Any]) -> None:
    """Compare a file with what was handed over, in order."""
    picture = Rrd(file)
    for quantity in ("position_error", "ate_position"):
        stamps, values = picture.numbers(f"metrics/{quantity}/{NAME}")
        wanted = np.array(report["handed"][quantity], dtype=object)
        assert stamps.tolist() == wanted[:, 0].tolist()
        assert values.tolist() == wanted[:, 1].tolist()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rrd, dict[str, Any], Path]:
    """The file of a run without any viewer."""
    folder = tmp_path_factory.mktemp("file")
    report = told(drive("file", folder))
    return Rrd(folder / "run.rrd"), report, folder / "run.rrd"


def test_file_has_the_numbers_that_were_handed_over(
    finished: tuple[Rrd, dict[str, Any], Path],
) -> None:
    _, report, path = finished
    assert report["closed"] == [True]
    assert report["dropped"] == [0]
    assert_whole(path, report)


@pytest.mark.slow
def test_file_stays_small(tmp_path: Path) -> None:
    told(drive("file", tmp_path, seconds=120.0, speed=1.0))
    assert (tmp_path / "run.rrd").stat().st_size / 120.0 <= 10_000.0


def shown_at(picture: Rrd, now: int) -> np.ndarray:
    """Return the points of the estimate's path that are in sight at a time, in its own frame."""
    points = []
    for part in ("past", "recent", "newest"):
        stamps, rows = picture.strips(f"{FRAME}/path/{part}")
        until = rows[: int(np.searchsorted(stamps, now, side="right"))]
        points += [strip for row in (until if part == "past" else until[-1:]) for strip in row]
    return np.concatenate([*points, np.empty((0, 3))])


def test_whole_past_stands_at_the_last_alignment_at_every_time(
    finished: tuple[Rrd, dict[str, Any], Path],
) -> None:
    picture, report, _ = finished
    estimate = simulate(0, 30.0).estimate
    handed = report["handed"]["alignment"]
    stamps, transforms = picture.transforms(FRAME)
    assert stamps.tolist() == [each[0] for each in handed]
    for share in np.linspace(0.05, 1.0, 20):
        now = int(stamps[0] + share * (stamps[-1] - stamps[0]))
        row = int(np.searchsorted(stamps, now, side="right")) - 1
        rotation, translation, scale = transforms[row]
        wanted = np.array(handed[row][1:])
        assert scale == 1.0
        assert rotation == pytest.approx(wanted[:9].reshape(3, 3), abs=1e-6)
        assert translation == pytest.approx(wanted[9:], abs=1e-5)
        points = shown_at(picture, now)
        past = estimate.positions[estimate.stamps <= now]
        # Every pose so far is on the path, but for those between two that are drawn.
        from_path = np.linalg.norm(past[::5, None] - points[None], axis=2).min(axis=1)
        assert from_path.max() < 0.6  # a fifth of a second at the flight's speed
        ahead = np.linalg.norm(points[:, None] - past[None], axis=2).min(axis=1)
        assert ahead.max() < 1e-5


def test_far_from_the_origin_nothing_steps(tmp_path: Path) -> None:
    place = np.array([432_100.0, 5_012_345.0, 410.0])
    report = told(drive("file", tmp_path, 10.0, 3.0, ",".join(map(str, place))))
    picture = Rrd(tmp_path / "run.rrd")
    (origin,) = picture.rows("__properties/origin", "groundtruth_m")[1]
    truth, estimate = flight_at(place, 10.0)
    for entity, trajectory in (("groundtruth", truth), (f"estimate/{NAME}", estimate)):
        stamps, rows = picture.strips(f"world/{entity}/path/recent")
        points = np.array([row[0][-1] for row in rows if row], dtype=np.float64)
        stamps = stamps[[bool(row) for row in rows]]
        wanted = trajectory.positions[np.searchsorted(trajectory.stamps, stamps)]
        steps = np.diff(points, axis=0) - np.diff(wanted, axis=0)
        # A step of float32 at 5e6 m would be half a metre.
        assert np.abs(steps).max() < 1e-4
    _, transforms = picture.transforms(FRAME)
    rotation, translation, _ = transforms[-1]
    moved = points @ rotation.T + translation + np.array(origin)
    # What is drawn is where the numbers say it is.
    error = np.linalg.norm(moved[-1] - truth.positions[np.searchsorted(truth.stamps, stamps[-1])])
    assert error < 2.0 * max(value for _, value in report["handed"]["position_error"])


@pytest.mark.slow
def test_viewer_that_is_absent(port: int, tmp_path: Path) -> None:
    report = told(drive(f"connect:{url(port)}", tmp_path))
    assert report["closed"] == [True, True]
    assert report["dropped"][0] == 0 < report["dropped"][1]
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_viewer_that_is_late_gets_everything(port: int, tmp_path: Path) -> None:
    process = drive(f"serve:{port}", tmp_path)
    time.sleep(6.0)
    with rerun(url(port), "--save", str(tmp_path / "late.rrd")):
        report = told(process)
        time.sleep(1.0)
    assert_whole(tmp_path / "run.rrd", report)
    late = Rrd(tmp_path / "late.rrd")
    stamps, _ = late.numbers(f"metrics/position_error/{NAME}")
    first = report["handed"]["position_error"][0][0]
    assert stamps[0] == first
    assert len(stamps) > 0.9 * len(report["handed"]["position_error"])


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["serve", "connect"])
def test_viewer_that_freezes_for_a_minute(mode: str, port: int, tmp_path: Path) -> None:
    if mode == "connect":
        viewer, value = receiver(port, tmp_path / "seen.rrd"), f"connect:{url(port)}"
    else:
        viewer, value = rerun(url(port), "--save", str(tmp_path / "seen.rrd")), f"serve:{port}"
    with viewer as frozen:
        time.sleep(2.0)
        process = drive(value, tmp_path, seconds=72.0, speed=1.0)
        time.sleep(6.0)
        frozen.send_signal(signal.SIGSTOP)
        time.sleep(60.0)
        frozen.send_signal(signal.SIGCONT)
        report = told(process)
    assert report["closed"][0]
    assert report["dropped"][0] == 0
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_viewer_that_is_killed(port: int, tmp_path: Path) -> None:
    process = drive(f"serve:{port}", tmp_path)
    time.sleep(4.0)
    with rerun(url(port), "--save", str(tmp_path / "seen.rrd")) as killed:
        time.sleep(2.0)
        killed.kill()
    report = told(process)
    assert report["closed"] == [True, True]
    assert report["dropped"] == [0, 0]
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_viewer_that_is_killed_and_restarted(port: int, tmp_path: Path) -> None:
    with receiver(port, tmp_path / "first.rrd") as killed:
        time.sleep(2.0)
        process = drive(f"connect:{url(port)}", tmp_path, seconds=60.0, speed=2.5)
        time.sleep(8.0)
        killed.kill()
        killed.wait()
    time.sleep(3.0)
    with receiver(port, tmp_path / "second.rrd"):
        report = told(process)
        time.sleep(1.0)
    assert report["dropped"][0] == 0 < report["dropped"][1]
    assert_whole(tmp_path / "run.rrd", report)
    # The path that it has missed is drawn anew for the second.
    _, rows = Rrd(tmp_path / "second.rrd").strips(f"{FRAME}/path/past")
    begin = simulate(0, 60.0).estimate.positions[:5]
    assert min(np.linalg.norm(begin - row[0][0], axis=1).min() for row in rows) < 1e-3
    numbers, _ = Rrd(tmp_path / "second.rrd").numbers(f"metrics/position_error/{NAME}")
    assert numbers[-1] == report["handed"]["position_error"][-1][0]


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[None]:
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
        capture_output=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip("to fill a disk, the tests must be allowed to mount a small one")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.slow
def test_full_disk_leaves_what_fits(tmp_path: Path) -> None:
    with small_disk(tmp_path, "350k"):
        report = told(drive("file", tmp_path, seconds=75.0, speed=1.5))
        picture = Rrd(tmp_path / "run.rrd")
    assert report["trouble"] == [
        f"{tmp_path / 'run.rrd'} can't be written: no space left on device"
    ]
    assert report["dropped"][0] > 0
    stamps, values = picture.numbers(f"metrics/position_error/{NAME}")
    assert len(stamps) > 100
    wanted = report["handed"]["position_error"][: len(stamps)]
    assert values.tolist() == [value for _, value in wanted]


@pytest.mark.slow
def test_disk_without_any_room_leaves_no_stub(tmp_path: Path) -> None:
    with small_disk(tmp_path, "60k"):
        report = told(drive("file", tmp_path, seconds=15.0, speed=1.5))
        assert report["closed"] == [True]
        assert not (tmp_path / "run.rrd").exists()
    assert "no space left on device" in report["trouble"][0]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("serve:{port}", "port {port}: address already in use"),
        ("file", "run.rrd can't be written: is a directory"),
    ],
)
def test_sink_that_cannot_be_had(value: str, said: str, port: int, tmp_path: Path) -> None:
    if value == "file":
        (tmp_path / "run.rrd").mkdir()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        report = told(drive(value.format(port=port), tmp_path, seconds=5.0))
    assert said.format(port=port) in report["trouble"][-1]


@pytest.mark.parametrize(
    "value", ["fil", "serve:x", "serve:0", "connect:", "connect:http://127.0.0.1:9876", ""]
)
def test_values_that_mean_nothing(value: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"rerun\+http://127\.0\.0\.1:9876/proxy"):
        sinks_for(value, tmp_path / "run.rrd", "x")
