"""What a newcomer runs: it ends with what is where, whatever it had to do without."""

from __future__ import annotations

import copy
import json
import shlex
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from trajeval_ros.cli.app import main
from trajeval_ros.cli.demo import comparison

PATIENCE_S = 600
# The Vulkan loader finds no driver, as on a machine without one.
BLIND = dict.fromkeys(("VK_DRIVER_FILES", "VK_ICD_FILENAMES"), "/nonexistent")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The result of a recorded flight."""
    folder = tmp_path_factory.mktemp("recorded")
    bag, file = folder / "flight", folder / "result.json"
    assert main(["simulate", str(bag), "--duration", "60"]) == 0
    sources = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry"]
    options = ["--modality", "stereo-inertial", "--quiet", "--json", str(file)]
    assert main(["evaluate", *sources, *options]) == 0
    return json.loads(file.read_text())


def test_equal_results_agree(recorded: Any) -> None:
    lines = comparison(recorded, recorded)
    assert lines[-1] == "All messages arrived, and both columns agree."
    assert "lost" not in "".join(lines)


def test_lost_messages_stand_beside_the_columns_and_explain_them(recorded: Any) -> None:
    live = copy.deepcopy(recorded)
    live["groundtruth"]["poses"] -= 3034
    live["runs"][0]["estimate"]["poses"] -= 2
    live["runs"][0]["ate"]["rotation_deg"]["rmse"] *= 1.3
    lines = comparison(live, recorded)
    (truth,) = [line for line in lines if line.startswith("groundtruth messages")]
    (odometry,) = [line for line in lines if line.startswith("odometry messages")]
    assert truth.endswith("3034 lost")
    assert odometry.endswith("2 lost")
    assert "differ: 3036 messages lost" in lines[-1]


def test_a_difference_without_a_loss_is_not_explained_away(recorded: Any) -> None:
    live = copy.deepcopy(recorded)
    live["runs"][0]["ate"]["position_m"]["rmse"] *= 1 + 1e-6
    assert "Please report" in comparison(live, recorded)[-1]


def test_a_folder_with_other_things_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "live" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    assert main(["demo", str(tmp_path)]) == 2
    assert "is not from an earlier demo" in capsys.readouterr().err
    assert mine.read_text() == "mine"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A small recording for Rerun."""
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    bag, file = tmp_path / "flight", tmp_path / "run.rrd"
    assert main(["simulate", str(bag), "--duration", "20"]) == 0
    sources = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry"]
    assert main(["evaluate", *sources, "--gauge", "yaw", "--rrd", str(file), "--quiet"]) == 0
    return file


def test_a_screenshot_that_takes_too_long_is_one_sentence(recording: Path, tmp_path: Path) -> None:
    from trajeval_ros.exceptions import InputError
    from trajeval_ros.viewer.screenshot import save_png

    # Shorter than the viewer takes to settle on any machine.
    with pytest.raises(
        InputError, match=r"did not draw .* within 0\.2 s; close other programs"
    ) as caught:
        save_png(recording, tmp_path / "screen.png", patience_s=0.2)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "screen.png").exists()


def test_a_driver_that_is_missed_late_is_named(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from trajeval_ros.exceptions import InputError
    from trajeval_ros.viewer import screenshot

    for name in BLIND:
        monkeypatch.setenv(name, BLIND[name])
    # As on a busy machine: the viewer is taken for settled while it still looks for a driver.
    monkeypatch.setattr(screenshot, "_wait_for", lambda *_: None)
    for limit in ("_PATIENCE_S", "_SETTLE_S"):
        monkeypatch.setattr(screenshot, limit, PATIENCE_S)
    with pytest.raises(InputError, match="needs a Vulkan driver"):
        screenshot.save_png(recording, tmp_path / "screen.png")


def test_what_the_sdk_raises_is_one_sentence(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from trajeval_ros.exceptions import InputError
    from trajeval_ros.viewer.screenshot import ask_for_screenshot

    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # taken, and nobody listens
        address = f"rerun+http://127.0.0.1:{nobody.getsockname()[1]}/proxy"
        with pytest.raises(InputError, match="took no screenshot"):
            ask_for_screenshot(address, tmp_path / "screen.png")


def demo(folder: str, where: Path, environment: dict[str, str]) -> str:
    """Run the demo; returns what it prints on stdout."""
    done = subprocess.run(
        [sys.executable, "-m", "trajeval_ros", "demo", folder],
        cwd=where,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def last_words(message: str) -> dict[str, str]:
    """Return the last lines by what they are about."""
    lines = message[message.index("--- Results") :].splitlines()[1:]
    words = dict(line.split(":", 1) for line in lines[:3])
    words["next"] = lines[-1]
    assert lines[-2].startswith("next, ")
    return {key: value.strip() for key, value in words.items()}


@pytest.mark.slow
def test_without_a_driver_to_draw_with_it_ends_well_and_says_what_is_where(
    environment: dict[str, str], tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    words = last_words(demo("out", tmp_path, {**environment, **BLIND}))
    assert words["picture"].startswith("none: Rerun's viewer needs a Vulkan driver")
    assert (tmp_path / words["recording"]).is_file()
    assert (tmp_path / words["report"].split(",")[0]).is_file()
    command = shlex.split(words["next"])
    assert command[-2 if command[-1] == "--web" else -1] == words["recording"]
    # What it says to type next starts.
    process = subprocess.Popen(
        [*command, *(["--web"] if command[-1] != "--web" else [])],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("open http://127.0.0.1")
    finally:
        process.send_signal(signal.SIGINT)  # a kill would leave Rerun's program running
        process.wait()


@pytest.mark.ros
def test_live_and_recorded_agree(environment: dict[str, str], tmp_path: Path) -> None:
    pytest.importorskip(
        "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
    )
    text = demo("out", tmp_path, environment)
    assert "All messages arrived, and both columns agree." in text
    assert (tmp_path / last_words(text)["report"].split(",")[0]).is_file()
