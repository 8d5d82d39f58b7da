"""The page of an evaluation: what it has, and foreign names in it."""

from __future__ import annotations

import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest
from written_trajectories import write

pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `plot`")

from trajeval_ros.cli.app import main
from trajeval_ros.simulation.drifting_odometry import simulate

NASTY = "<script>alert(1)<b> & 'x'"


class Tags(HTMLParser):
    """The tags of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        self.tags.append(tag)


def write_pair(folder: Path) -> tuple[str, str]:
    flight = simulate(0, 20.0)
    write(folder / "gt.txt", flight.groundtruth)
    write(folder / "vio.txt", flight.estimate)
    return str(folder / "gt.txt"), str(folder / "vio.txt")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("page")
    groundtruth, estimate = write_pair(folder)
    out = folder / "out"
    command = ["evaluate", groundtruth, f"{NASTY}={estimate}", "--output", str(out), "-q"]
    assert main([*command, "--modality", "stereo-inertial"]) == 0
    return (out / "report.html").read_text(encoding="utf-8")


def test_a_page_has_the_result_figures_tables_definitions_and_the_command(page: str) -> None:
    headings = re.findall(r"<h2[^>]*>([^<]*)</h2>", page)
    expected = ["Figures", "Tables", "Definitions", "Command"]
    assert [heading for heading in headings if heading != "Messages"] == expected
    text = unescape(page)
    assert f"{NASTY}: position error " in text
    assert "aligned by yaw and position" in text
    assert "Absolute trajectory error" in text
    assert "--modality stereo-inertial" in text.rpartition("<pre>")[2]
    assert page.count("<svg") == 4
    for title in ("Top view", "Side view", "Absolute error", "Relative error"):
        assert f"<h3>{title}" in page


def test_a_page_needs_no_network_and_foreign_names_are_text(page: str) -> None:
    without_names = re.sub(r'xmlns(:\w+)?="[^"]*"', "", page)
    assert not re.findall(r"https?://|src=|@import|url\((?!#)", without_names)
    assert "<script>alert" not in page
    tags = Tags(page).tags
    assert tags.count("script") == 1  # the page's own
    assert "default-src 'none'" in page


def test_without_matplotlib_the_page_has_no_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trajeval_ros.cli.evaluation_folder._HAVE_FIGURES", False)
    groundtruth, estimate = write_pair(tmp_path)
    assert main(["evaluate", groundtruth, estimate, "--output", str(tmp_path / "o"), "-q"]) == 0
    text = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    assert "<svg" not in text
    assert "Figures" not in re.findall(r"<h2[^>]*>([^<]*)</h2>", text)


def test_a_page_of_someone_else_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    groundtruth, estimate = write_pair(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("mine")
    assert main(["evaluate", groundtruth, estimate, "--output", str(out), "-q"]) == 2
    assert "report.html is not from an evaluation" in capsys.readouterr().err
    assert (out / "report.html").read_text() == "mine"
