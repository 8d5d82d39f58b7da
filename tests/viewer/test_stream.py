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
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.simulation.drifting_odometry import simulate
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.viewer.sinks import ServerTarget, ViewerTarget, sinks_for
from trajeval_ros.viewer.stream import DrawingThread

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")

from paths import ROOT, SUPPORT
from rerun_driver import flight_at
from rrd import Rrd
from small_disk import mounted
from waiting import PATIENCE_S, until

DRIVER = SUPPORT.joinpath("rerun_driver.py")
NAME = "vio_odometry"
FRAME = f"world/estimate/{NAME}"
# A stream holds 2000 things to draw. A flight of so many seconds has fewer in all, so that viewers
# lack nothing however busy the machine is, and however fast it is flown.
FLIGHT_S, FAST = 30.0, 20.0


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
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def receiver(port: int, file: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Listen as a viewer does, and keep what comes in a file."""
    with rerun("--bind", "127.0.0.1", "--port", str(port), "--save", str(file)) as process:
        until(lambda: listens(port), f"it listens at port {port}")
        yield process


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Driver:
    """A process that draws a flight."""

    def __init__(
        self,
        value: str,
        folder: Path,
        seconds: float = FLIGHT_S,
        speed: float = FAST,
        place: str = "0,0,0",
        pauses: str = "",
    ) -> None:
        # Not in the folder, whose disk may be full; open for as long as the process runs.
        self._out = tempfile.TemporaryFile()  # noqa: SIM115
        self._err = tempfile.TemporaryFile()  # noqa: SIM115
        arguments = [value, str(folder), str(seconds), str(speed), place, pauses]
        self._process = subprocess.Popen(
            [sys.executable, str(DRIVER), *arguments],
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=self._out,
            stderr=self._err,
        )

    def wait_for(self, line: str) -> None:
        until(
            lambda: line in read(self._out) or self._process.poll() is not None,
            f"the driver says {line!r}",
        )
        assert line in read(self._out), read(self._err)

    def go_on(self) -> None:
        """Go on after a pause."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")
        self._process.stdin.flush()

    def report(self) -> dict[str, Any]:
        """Wait until it has ended, and return what it tells."""
        try:
            assert self._process.wait(PATIENCE_S) == 0, read(self._err)
        finally:
            self._process.kill()
            self._process.wait()
        assert "Traceback" not in read(self._err)
        report: dict[str, Any] = json.loads(read(self._out).splitlines()[-1])
        return report


def read(file: Any) -> str:
    """Read a file that another process writes with the same offset."""
    return os.pread(file.fileno(), 2**26, 0).decode()


def seen(file: Path) -> np.ndarray:
    """Return the stamps of the errors that a viewer has received so far, none from a torn file.

    A receiver that is ended in the middle of a write leaves its file torn, and Rerun then reads
    none of it: look while the receiver runs, in `until`.
    """
    try:
        stamps, _ = Rrd(file).numbers(f"metrics/position_error/{NAME}")
    except Exception:  # its last message is half written, or the file isn't there yet
        return np.empty(0, np.int64)
    return stamps


def shows_the_begin(file: Path, now: int) -> bool:
    """Return whether a path that is in sight at a time begins where the estimate does."""
    try:
        strips = Rrd(file).path(FRAME, now)
    except RuntimeError:  # its last message is half written
        return False
    begin = simulate(0, 60.0).estimate.positions[:5]
    return any(np.linalg.norm(begin - strip[0], axis=1).min() < 1e-3 for strip in strips)


def assert_whole(file: Path, report: dict[str, Any]) -> None:
    """Compare a file with what was handed over, in order."""
    picture = Rrd(file)
    for quantity in ("position_error", "ate_position"):
        stamps, values = picture.numbers(f"metrics/{quantity}/{NAME}")
        expected = np.array(report["handed"][quantity], dtype=object)
        assert stamps.tolist() == expected[:, 0].tolist()
        assert values.tolist() == expected[:, 1].tolist()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rrd, dict[str, Any], Path]:
    """The file of a run without any viewer."""
    folder = tmp_path_factory.mktemp("file")
    report = Driver("file", folder).report()
    return Rrd(folder / "run.rrd"), report, folder / "run.rrd"


@pytest.mark.slow
def test_file_has_the_numbers_that_were_handed_over(
    finished: tuple[Rrd, dict[str, Any], Path],
) -> None:
    _, report, path = finished
    assert report["closed"] == [True]
    assert report["dropped"] == [0]
    assert_whole(path, report)


@pytest.mark.slow
def test_file_stays_small(tmp_path: Path) -> None:
    Driver("file", tmp_path, seconds=45.0, speed=1.0).report()
    # 43 MB an hour: poses, errors at 10 Hz and states.
    assert (tmp_path / "run.rrd").stat().st_size / 45.0 <= 12_000.0


@pytest.mark.slow
def test_whole_past_stands_at_the_last_alignment_at_every_time(
    finished: tuple[Rrd, dict[str, Any], Path],
) -> None:
    picture, report, _ = finished
    estimate = simulate(0, 30.0).estimate
    handed = report["handed"]["alignment"]
    stamps, transforms = picture.transforms(FRAME)
    assert stamps.tolist() == [item[0] for item in handed]
    for share in np.linspace(0.05, 1.0, 20):
        now = int(stamps[0] + share * (stamps[-1] - stamps[0]))
        row = int(np.searchsorted(stamps, now, side="right")) - 1
        rotation, translation, scale = transforms[row]
        expected = np.array(handed[row][1:])
        assert scale == 1.0
        assert rotation == pytest.approx(expected[:9].reshape(3, 3), abs=1e-6)
        assert translation == pytest.approx(expected[9:], abs=1e-5)
        points = np.concatenate([*picture.path(FRAME, now), np.empty((0, 3))])
        past = estimate.positions[estimate.stamps <= now]
        # Every pose so far is on the path, but for those between two that are drawn.
        from_path = np.linalg.norm(past[::5, None] - points[None], axis=2).min(axis=1)
        assert from_path.max() < 0.6  # a fifth of a second at the flight's speed
        ahead = np.linalg.norm(points[:, None] - past[None], axis=2).min(axis=1)
        assert ahead.max() < 1e-5


@pytest.mark.slow
def test_far_from_the_origin_nothing_steps(tmp_path: Path) -> None:
    place = np.array([432_100.0, 5_012_345.0, 410.0])
    report = Driver("file", tmp_path, 10.0, FAST, ",".join(map(str, place))).report()
    picture = Rrd(tmp_path / "run.rrd")
    (origin,) = picture.rows("__properties/origin", "groundtruth_m")[1]
    groundtruth, estimate = flight_at(place, 10.0)
    for entity, trajectory in (("groundtruth", groundtruth), (f"estimate/{NAME}", estimate)):
        stamps, rows = picture.strips(f"world/{entity}/path/recent")
        points = np.array([row[0][-1] for row in rows if row], dtype=np.float64)
        stamps = stamps[[bool(row) for row in rows]]
        expected = trajectory.positions[np.searchsorted(trajectory.stamps, stamps)]
        steps = np.diff(points, axis=0) - np.diff(expected, axis=0)
        # A step of float32 at 5e6 m would be half a metre.
        assert np.abs(steps).max() < 1e-4
    _, transforms = picture.transforms(FRAME)
    rotation, translation, _ = transforms[-1]
    moved = points @ rotation.T + translation + np.array(origin)
    # What is drawn is where the numbers say it is.
    error = np.linalg.norm(
        moved[-1] - groundtruth.positions[np.searchsorted(groundtruth.stamps, stamps[-1])]
    )
    assert error < 2.0 * max(value for _, value in report["handed"]["position_error"])


@pytest.mark.slow
def test_viewer_that_is_absent(port: int, tmp_path: Path) -> None:
    report = Driver(f"connect:{url(port)}", tmp_path).report()
    assert report["closed"] == [True, True]
    assert report["dropped"][0] == 0 < report["dropped"][1]
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_viewer_that_is_late_gets_everything(port: int, tmp_path: Path) -> None:
    driver = Driver(f"serve:{port}", tmp_path, pauses="20,29")
    late = tmp_path / "late.rrd"
    driver.wait_for("paused at 20")
    until(lambda: listens(port), "it serves")
    with rerun(url(port), "--save", str(late)):
        until(lambda: len(seen(late)), "it shows something")
        driver.go_on()
        driver.wait_for("paused at 29")
        until(lambda: len(seen(late)) > 0.9 * 20 * 29, "it shows all")
        driver.go_on()
        report = driver.report()
        first = report["handed"]["position_error"][0][0]
        until(lambda: seen(late)[:1].tolist() == [first], "it shows the beginning")
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["serve", "connect"])
def test_viewer_that_freezes_is_not_waited_for(mode: str, port: int, tmp_path: Path) -> None:
    file = tmp_path / "seen.rrd"
    with ExitStack() as stack:
        if mode == "connect":
            frozen = stack.enter_context(receiver(port, file))
            driver = Driver(f"connect:{url(port)}", tmp_path, 60.0, 6.0, pauses="10")
        else:
            driver = Driver(f"serve:{port}", tmp_path, 60.0, 6.0, pauses="10")
            until(lambda: listens(port), "it serves")
            frozen = stack.enter_context(rerun(url(port), "--save", str(file)))
        driver.wait_for("paused at 10")
        until(lambda: len(seen(file)), "it shows something")
        frozen.send_signal(signal.SIGSTOP)
        driver.go_on()
        driver.wait_for("all is handed over")  # whoever waited for the viewer would never say so
        frozen.send_signal(signal.SIGCONT)
        report = driver.report()
    assert report["closed"][0]
    assert report["dropped"][0] == 0
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_a_viewer_that_does_not_listen_is_reported(port: int, tmp_path: Path) -> None:
    scene = LiveScene("flight", ["vio"], Gauge.YAW)
    thread = DrawingThread(ViewerTarget(url(port), "run"), scene)
    until(lambda: thread.absence, "it has tried")
    assert thread.absence.startswith(f"no viewer answers at {url(port)}")
    with receiver(port, tmp_path / "seen.rrd"):
        until(lambda: not thread.absence, "it has found one")
    until(lambda: thread.absence, "it has lost it")
    assert thread.trouble == ""
    thread.close()


@pytest.mark.slow
def test_viewer_that_is_killed(port: int, tmp_path: Path) -> None:
    driver = Driver(f"serve:{port}", tmp_path, pauses="10")
    driver.wait_for("paused at 10")
    until(lambda: listens(port), "it serves")
    with rerun(url(port), "--save", str(tmp_path / "seen.rrd")) as killed:
        until(lambda: len(seen(tmp_path / "seen.rrd")), "it shows something")
        killed.kill()
    driver.go_on()
    report = driver.report()
    assert report["closed"] == [True, True]
    assert report["dropped"] == [0, 0]
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_viewer_that_is_killed_and_restarted(port: int, tmp_path: Path) -> None:
    first, second = tmp_path / "first.rrd", tmp_path / "second.rrd"
    value = f"connect:{url(port)}"
    with receiver(port, first) as killed:
        driver = Driver(value, tmp_path, 35.0, 2.5, pauses="5,25,30")
        driver.wait_for("paused at 5")
        until(lambda: len(seen(first)), "the first shows something")
        killed.kill()
        killed.wait()
    driver.go_on()
    driver.wait_for("paused at 25")
    with receiver(port, second):
        driver.go_on()
        driver.wait_for("paused at 30")
        until(second.exists, "the second has something")
        driver.go_on()
        report = driver.report()
        last = report["handed"]["position_error"][-1][0]
        until(lambda: seen(second)[-1:].tolist() == [last], "the second shows the end")
        # The path that it has missed is drawn anew for the second.
        until(lambda: shows_the_begin(second, last), "the second shows the begin of the path")
    assert report["dropped"][0] == 0 < report["dropped"][1]
    assert_whole(tmp_path / "run.rrd", report)


@pytest.mark.slow
def test_full_disk_leaves_what_fits(tmp_path: Path) -> None:
    with mounted(tmp_path / "disk", "350k") as disk:
        report = Driver("file", disk, seconds=75.0, speed=5.0).report()
        picture = Rrd(disk / "run.rrd")
    assert report["trouble"] == [f"{disk / 'run.rrd'} can't be written: no space left on device"]
    assert report["dropped"][0] > 0
    stamps, values = picture.numbers(f"metrics/position_error/{NAME}")
    assert len(stamps) > 100
    expected = report["handed"]["position_error"][: len(stamps)]
    assert values.tolist() == [value for _, value in expected]


@pytest.mark.slow
@pytest.mark.parametrize("size", ["40k", "60k"])
def test_disk_without_any_room_leaves_no_stub(size: str, tmp_path: Path) -> None:
    with mounted(tmp_path / "disk", size) as disk:
        report = Driver("file", disk, seconds=15.0).report()
        assert report["closed"] == [True]
        assert not (disk / "run.rrd").exists()
    assert "no space left on device" in report["trouble"][0]


@pytest.mark.parametrize(
    ("value", "address"),
    [
        ("serve", "127.0.0.1:9876"),
        ("serve:1234", "127.0.0.1:1234"),
        ("serve:127.0.0.2:1234", "127.0.0.2:1234"),
        ("serve:[::1]:1234", "[::1]:1234"),
        ("serve:0.0.0.0:1234", f"{socket.gethostname()}:1234"),
    ],
)
def test_address_for_viewers(value: str, address: str, tmp_path: Path) -> None:
    _, server = sinks_for(value, tmp_path / "run.rrd", "x")
    assert isinstance(server, ServerTarget)
    assert server.url == f"rerun+http://{address}/proxy"


def test_server_listens_only_at_its_address(port: int, tmp_path: Path) -> None:
    _, server = sinks_for(f"serve:127.0.0.2:{port}", tmp_path / "run.rrd", "x")
    recording = server.open(None)

    def listens_at(host: str) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex((host, port)) == 0

    try:
        until(lambda: listens_at("127.0.0.2"), "it serves")
        assert not listens_at("127.0.0.1")
    finally:
        server.close(recording)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("serve:{port}", "port {port}: address already in use"),
        ("file", "run.rrd can't be written: is a directory"),
    ],
)
def test_sink_that_cannot_be_had(value: str, message: str, tmp_path: Path) -> None:
    if value == "file":
        (tmp_path / "run.rrd").mkdir()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        report = Driver(value.format(port=port), tmp_path, seconds=5.0).report()
    assert message.format(port=port) in report["trouble"][-1]


@pytest.mark.parametrize(
    "value",
    [
        "fil",
        "serve:x",
        "serve:0",
        "serve:host:9876",
        "serve:0.0.0.0:x",
        "connect:",
        "connect:http://127.0.0.1:9876",
        "",
    ],
)
def test_values_that_mean_nothing(value: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"rerun\+http://127\.0\.0\.1:9876/proxy"):
        sinks_for(value, tmp_path / "run.rrd", "x")
