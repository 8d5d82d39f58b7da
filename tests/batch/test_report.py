"""The report as a person sees it: in a real browser, light and dark, wide and on a phone."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import compare, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")

from paths import ROOT
from written_trajectories import write

from trajeval_ros.cli.app import main
from trajeval_ros.report.comparison_page import Plot, ReportPages, RunPage
from trajeval_ros.report.matrix import Cell, Matrix
from trajeval_ros.simulation.drifting_odometry import simulate

pytestmark = pytest.mark.slow
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
EUROC = ROOT / "config" / "euroc.yaml"
NASTY = "<script>alert(1)</script> & \"quoted\" 'name'"


@pytest.fixture(scope="module")
def euroc(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the 11 shared runs of a sequence of EuRoC, as the README makes it of all."""
    out = tmp_path_factory.mktemp("report")
    config = out.with_name("euroc.yaml")
    one = f"folder: {shared_data / 'euroc'}\nsequences: [V2_03]\n"
    config.write_text(EUROC.read_text() + one)
    assert compare(config, "--quiet", output=out, figures=11) == 0
    return out / "report.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("there is no chromium")
    reason = "playwright is missing; `make install` has it"
    sync_api = pytest.importorskip("playwright.sync_api", reason=reason)
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=BROWSER,
            args=["--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND"],
        )
        yield browser
        browser.close()


def opened(
    browser: Any, page: Path, width: int = 1280, scheme: str = "light"
) -> tuple[Any, list[str]]:
    """Open a page; return it, and a list of all that it complains of or asks for."""
    context = browser.new_context(viewport={"width": width, "height": 850}, color_scheme=scheme)
    tab, heard = context.new_page(), []
    tab.on("console", lambda message: heard.append(message.text))
    tab.on("pageerror", lambda error: heard.append(str(error)))
    tab.on("dialog", lambda dialog: (heard.append(dialog.message), dialog.dismiss()))
    address = page.as_uri()
    tab.on("request", lambda asked: heard.append(asked.url) if asked.url != address else None)
    tab.goto(address)
    return tab, heard


def test_it_is_one_small_file_that_needs_nothing_else(euroc: Path) -> None:
    text = euroc.read_text(encoding="utf-8")
    assert len(text) < 11 * 150_000
    without_names = re.sub(r'xmlns(:\w+)?="[^"]*"|/\*\*\s.*?\*/', "", text, flags=re.DOTALL)
    assert not re.findall(r"https?://|src=|@import|url\((?!#)", without_names)
    assert text.count("<details ") == 11


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_opens_without_complaint_and_fits(
    width: int, scheme: str, euroc: Path, browser: Any
) -> None:
    tab, heard = opened(browser, euroc, width, scheme)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    dark = tab.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    assert dark == (scheme == "dark")
    # Text in figures has the page's colour, and its size can be read.
    texts = tab.locator("figure svg text").first
    assert texts.evaluate("each => getComputedStyle(each).fill") == tab.evaluate(
        "getComputedStyle(document.body).color"
    )
    assert texts.bounding_box()["height"] >= 8
    for figure in tab.locator("body > .plots > figure > svg").all():
        box = figure.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
        assert box["height"] > 100
    assert heard == []


def test_tables_sort_and_runs_unfold(euroc: Path, browser: Any) -> None:
    tab, heard = opened(browser, euroc)
    table = tab.locator("table.sortable").last
    heading = table.get_by_role("button", name="position ATE")

    def column() -> list[float]:
        values = "rows => rows.map(row => Number(row.cells[4].dataset.value))"
        numbers: list[float] = table.locator("tbody tr").evaluate_all(values)
        return numbers

    before = column()
    heading.click()
    assert column() == sorted(before)
    assert table.locator("th[aria-sort=ascending]").count() == 1
    heading.click()
    assert column() == sorted(before, reverse=True)
    fold = tab.locator("#run5")
    assert not fold.locator("svg").first.is_visible()
    table.locator("a[href='#run5']").click()
    assert fold.locator("svg").first.is_visible()
    assert fold.locator("td", has_text="ATE, position [m]").is_visible()
    tab.locator("#run7 summary").click()
    assert tab.locator("#run7 svg").first.is_visible()
    assert heard == []


def test_names_are_text_wherever_they_come_from(tmp_path: Path, browser: Any) -> None:
    table = Matrix(
        "t", NASTY, (NASTY,), (NASTY,), ((NASTY, (Cell(1.0, NASTY),)),), ("1/1",), (1.0,)
    )
    run = RunPage(NASTY, NASTY, NASTY, "failed", NASTY, None, None, 0.0, warnings=(NASTY,))
    page = tmp_path / "report.html"
    pages = ReportPages(NASTY, "0", "")
    details = [pages.details(1, run)]
    written = pages.overview(NASTY, [NASTY], [table], [], [run], ["#run1"], details, "All runs")
    page.write_text(written)
    tab, heard = opened(browser, page)
    assert tab.title() == NASTY
    assert tab.locator("h1").inner_text() == NASTY
    assert heard == []


def test_control_characters_are_shown_and_figures_are_not_touched() -> None:
    name, figure = "a\x1b\u202eb", "<svg>\n</svg>"
    table = Matrix("t", name, (name,), (name,), ((name, (Cell(1.0, name),)),), ("1/1",), (1.0,))
    plots = [Plot(name, name, figure)]
    pages = ReportPages(name, "0", "")
    text = pages.overview(name, [name], [table], plots, [], [], [], "All runs")
    assert not {"\x1b", "\u202e"} & set(text)
    assert r"<h1>a\x1b\u202eb</h1>" in text
    assert figure in text


def test_details_of_many_runs_are_on_pages_of_their_own(
    tmp_path: Path, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trajeval_ros.batch.comparison_report._MOST_ON_A_PAGE", 2)
    config, out = write_runs(tmp_path, ["hall"]), tmp_path / "out"
    assert compare(config, "-q", output=out, figures=4) == 0
    assert {path.name for path in (out / "report").iterdir()} == {
        f"runs_{number}.html" for number in (1, 2)
    }
    report = out / "report.html"
    assert "<details " not in report.read_text()
    tab, heard = opened(browser, report)
    links = tab.locator("table.sortable").last.locator("tbody a")
    assert links.count() == 4
    links.nth(3).click()
    tab.wait_for_url("**/report/runs_2.html#run4")
    assert tab.locator("#run4 svg").first.is_visible()
    assert tab.locator("details").count() == 2
    tab.get_by_role("link", name="Report").click()
    tab.wait_for_url("**/report.html#runs")
    assert [item for item in heard if not item.startswith(out.as_uri())] == []
    # With fewer runs no page of the older report stays.
    (tmp_path / "bad" / "hall_trial0.txt").unlink()
    monkeypatch.setattr("trajeval_ros.batch.comparison_report._MOST_ON_A_PAGE", 100)
    assert compare(config, "-q", output=out) == 0
    assert not (out / "report").exists()
    assert report.read_text().count("<details ") == 3


def test_of_very_many_runs_details_are_of_those_that_stand_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trajeval_ros.batch.comparison_report._MOST_DETAILS", 3)
    config, out = write_runs(tmp_path, trials=3), tmp_path / "out"
    (tmp_path / "good" / "yard_trial1.txt").write_text("no trajectory\n")
    assert compare(config, "-q", output=out) == 0
    text = (out / "report.html").read_text()
    names = re.findall(r"<summary><b>([^<]*)</b>", text)
    assert names == ["good yard, trial 1", "bad hall, trial 1", "bad hall, trial 2"]
    assert "Details are shown for 3 runs: failed runs first" in text
    assert ">12 runs of 2 algorithms on 2 sequences: 11 evaluated" in text


def test_a_table_that_is_too_large_for_a_page_is_cut_and_keeps_its_ranks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trajeval_ros.report.comparison_page._MOST_CELLS", 4)
    values = ((3.0, 3.0, 3.0), (1.0, 2.0, 1.0))
    rows = tuple((f"a{row}", tuple(map(Cell, value))) for row, value in enumerate(values))
    table = Matrix("ate", "ATE", (), ("x", "y", "z"), rows, ("1/1",) * 2, (1.0, 1.0))
    text = ReportPages("t", "0", "").overview("", [], [table], [], [], [], [], "All runs")
    assert re.findall(r'class="rank(\d)">([\d.]+)', text) == [
        ("2", "3.000"), ("2", "3.000"), ("1", "1.000"), ("1", "2.000"),
    ]  # fmt: skip
    assert "first 2 of 2 rows and 2 of 3 columns; all are in ate.csv" in text


def test_two_reports_are_the_same_bytes_and_failed_runs_are_in_them(tmp_path: Path) -> None:
    config = write_runs(tmp_path, ["yard"], trials=1)
    (tmp_path / "bad" / "yard_trial0.txt").write_text("no trajectory\n")
    here, there = tmp_path / "here", tmp_path / "there"
    assert compare(config, "-q", output=here, figures=2) == 0
    # The figures of a process with another hash of strings.
    words = ["--workers", "1", "--figures", "2", "--output", str(there)]
    assert main(["compare", str(config), "-q", *words]) == 0
    pages = [(out / "report.html").read_text() for out in (here, there)]
    assert pages[0] == pages[1]
    assert "1 failed or missing. Failed runs are ranked last" in pages[0]
    assert '<span class="failed">failed</span>' in pages[0]


def test_a_tie_has_two_winners(tmp_path: Path) -> None:
    config = write_runs(tmp_path, algorithms=("one", "other"), trials=1)
    config.write_text(config.read_text() + "common_time_span: true\n")
    out = tmp_path / "out"
    assert compare(config, "--quiet", output=out) == 0
    text = (out / "report.html").read_text()
    assert "one and other each have the smallest position ATE on 2 of 2 sequences." in text


def test_runs_that_are_cut_are_counted_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_runs(tmp_path, trials=1)
    config.write_text(config.read_text() + "common_time_span: true\n")
    for text in ("4 runs evaluated; report", "0 runs evaluated, 4 unchanged; report"):
        assert compare(config, output=tmp_path / "out") == 0
        assert text in capsys.readouterr().out


LONG = "an_estimator_of_a_long_name__window_20__features_250__loop_closure_off__seed_1234567890"


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of one run whose name is longer than a phone is wide."""
    folder = tmp_path_factory.mktemp("evaluation")
    flight = simulate(0, 60.0)
    write(folder / "gt.txt", flight.groundtruth)
    write(folder / "vio.txt", flight.estimate)
    words = [
        str(folder / "gt.txt"),
        f"{LONG}={folder / 'vio.txt'}",
        "--output",
        str(folder / "out"),
    ]
    assert main(["evaluate", *words, "--modality", "stereo-inertial", "--quiet"]) == 0
    return folder / "out" / "report.html"


@pytest.mark.parametrize("width", [1280, 390])
def test_a_long_name_hides_no_numbers(width: int, evaluation: Path, browser: Any) -> None:
    tab, complaints = opened(browser, evaluation, width)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    names = tab.locator("td:first-child").all()
    assert max(name.bounding_box()["width"] for name in names) < 0.4 * width
    if width == 1280:  # no table scrolls
        for table in tab.locator(".scroll").all():
            assert table.evaluate("box => box.scrollWidth <= box.clientWidth")
    assert not complaints
