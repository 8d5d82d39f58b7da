"""What a person sees: pictures opened in the viewer itself, and as a page in a real browser."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import PATIENCE_S, until

from trajeval_ros.cli.app import main

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")

import readme_pictures
from paths import ROOT
from PIL import Image

from trajeval_ros.viewer import screenshot
from trajeval_ros.viewer.screenshot import headless_viewer, save_png

DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("*"), *Path("/etc/vulkan/icd.d").glob("*")]
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
LIVE = ROOT / "tests" / "support" / "rerun_driver.py"

pytestmark = pytest.mark.slow
needs_driver = pytest.mark.skipif(
    not DRIVERS, reason="there is no Vulkan driver; that of mesa-vulkan-drivers will do"
)


def environment() -> dict[str, str]:
    return {**os.environ, "CI": "1", "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Recorded runs with all there is to draw, and a live one."""
    folder = tmp_path_factory.mktemp("pictures")
    bag, drifting = folder / "flight", folder / "drifting"
    assert main(["simulate", str(bag), "--profile", "euroc", "--duration", "20"]) == 0
    assert main(["simulate", str(drifting), "--duration", "20"]) == 0
    sources = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry", "--gauge", "yaw"]
    made = {name: folder / f"{name}.rrd" for name in ("certain", "two")}
    more = ["--covariance", f"{bag}.npz", "--rrd", str(made["certain"]), "--quiet"]
    assert main(["evaluate", *sources, *more]) == 0
    sources = ["-g", f"{drifting}:/groundtruth/pose"]
    sources += 2 * ["-e", f"{drifting}:/vio/odometry"]
    more = ["--modality", "mono", "--rrd", str(made["two"]), "--quiet"]
    assert main(["evaluate", *sources, *more]) == 0
    live = folder / "live"
    live.mkdir()
    command = [sys.executable, str(LIVE), "file", str(live), "20", "4"]
    subprocess.run(command, env=environment(), check=True, capture_output=True)
    return {**made, "live": live / "run.rrd"}


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the viewer as long as it takes on a machine that is busy and draws in software."""
    monkeypatch.setattr(screenshot, "_PATIENCE_S", PATIENCE_S)


def coloured(png: Path) -> int:
    """Return the number of pixels in the space at the left that are no shade of grey."""
    pixels = np.asarray(Image.open(png).convert("RGB")).astype(int)
    space = pixels[60:-60, : pixels.shape[1] * 6 // 10]
    return int(np.count_nonzero(np.ptp(space, axis=2) > 40))


@needs_driver
@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("kind", ["certain", "two", "live"])
def test_views_have_nothing_to_report_at_three_times(
    kind: str, pictures: dict[str, Path], tmp_path: Path
) -> None:
    from rerun.experimental import ViewerClient

    def shown(viewer: ViewerClient) -> int:
        viewer.save_screenshot(str(tmp_path / "screen.png"))
        return coloured(tmp_path / "screen.png")

    seen = [100]
    with headless_viewer(pictures[kind]) as url, ViewerClient.connect(url) as viewer:
        until(
            lambda: any(recording.timelines for recording in viewer.get_state().recordings),
            "it is read",
        )
        (line,) = viewer.get_state().recordings[0].timelines
        assert line.name == "ros_time"
        for share in (0.25, 0.6, 1.0):
            now = round(line.start + share * (line.end - line.start))
            viewer.set_time("ros_time", timestamp=np.datetime64(now, "ns"), play_state="paused")
            until(lambda: shown(viewer) > seen[-1], "the path grows, and it is in sight")
            seen.append(shown(viewer))
            state = viewer.get_state()
            assert len(state.views) >= 6
            assert [report for view in state.views for report in view.reports] == []
        told = [log for log in viewer.get_logs() if log.level in ("WARN", "ERROR")]
    assert [item.message for item in told if "oftware rasterizer" not in item.message] == []
    assert seen == sorted(seen)


@needs_driver
@pytest.mark.usefixtures("patient")
def test_first_screen_as_a_png(pictures: dict[str, Path], tmp_path: Path) -> None:
    save_png(pictures["live"], tmp_path / "screen.png")
    assert coloured(tmp_path / "screen.png") > 1000


@pytest.fixture
def page(pictures: dict[str, Path]) -> Iterator[tuple[str, Any]]:
    """Where `trajeval view --web` says that its page is, and its process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "trajeval_ros", "view", "--web", str(pictures["two"])],
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[1], process
    finally:
        process.send_signal(signal.SIGINT)  # a kill would leave Rerun's program running
        process.wait()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="children are read from /proc")
@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGINT])
def test_what_was_started_ends_with_the_page(
    page: tuple[str, Any], ending: signal.Signals
) -> None:
    _, process = page
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert children
    process.send_signal(ending)
    assert process.wait(PATIENCE_S) in (0, 128 + ending)
    for child in children:
        until(lambda: not Path(f"/proc/{child}").exists(), "Rerun's program ends")  # noqa: B023


@pytest.mark.skipif(BROWSER is None, reason="there is no chromium")
def test_page_shows_the_picture_in_a_browser(page: tuple[str, Any], tmp_path: Path) -> None:
    reason = "playwright is missing; `make install` has it"
    sync_api = pytest.importorskip("playwright.sync_api", reason=reason)
    address, process = page
    assert address.startswith("http://127.0.0.1:")
    asked_for = []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=BROWSER,
            timeout=1e3 * PATIENCE_S,
            args=[
                "--no-sandbox",
                "--use-gl=angle",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            ],
        )
        tab = browser.new_page(viewport={"width": 1280, "height": 720})
        tab.on("request", lambda request: asked_for.append(request.url))
        tab.goto(f"{address}&renderer=webgl", wait_until="commit", timeout=1e3 * PATIENCE_S)

        def drawn() -> int:
            try:
                tab.screenshot(path=tmp_path / "page.png", timeout=1e3 * PATIENCE_S)
            except sync_api.Error:  # while the page starts, its frame may not be ready
                return 0
            return coloured(tmp_path / "page.png")

        until(lambda: drawn() >= 500, "the page shows the picture")
        browser.close()
    assert any(item.endswith(".wasm") for item in asked_for)
    # Ctrl-C ends it, and what it has started.
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 0


@needs_driver
def test_pictures_of_the_readme_are_not_stale(tmp_path: Path) -> None:
    """Draw them again; `python tests/support/readme_pictures.py` writes the new ones."""
    readme_pictures.draw(tmp_path)
    # The same programs draw the same pixels. A word less in the text panel changes a block by 9.
    apart = {
        name: readme_pictures.difference(tmp_path / name, readme_pictures.IMAGES / name)
        for name in readme_pictures.PICTURES
    }
    assert {name: value for name, value in apart.items() if value > 6.0} == {}


def test_the_animation_of_the_readme_lasts_ten_seconds_and_loads_fast() -> None:
    file = readme_pictures.IMAGES / readme_pictures.ANIMATION
    assert f"images/{file.name})" in (readme_pictures.ROOT / "README.md").read_text("utf-8")
    assert file.stat().st_size < 2_000_000
    with Image.open(file) as animation:
        frames = animation.n_frames
        animation.seek(frames - 1)
        animation.load()
        assert frames * animation.info["duration"] == 10_000
