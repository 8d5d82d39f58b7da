"""The figures of a comparison as files, and which of its runs compete for the best."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.report import canvas
from trajeval_ros.report.comparison_figures import box_plot, errors_over_time, overlay
from trajeval_ros.report.comparison_plots import Box, BoxPlot, ErrorsPlot, PathsPlot
from trajeval_ros.report.figure_style import FigureStyle, house_style


@pytest.mark.slow
def test_figures_are_written_as_files(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ["compare", str(write_runs(tmp_path)), "--output", str(out), "--quiet"]
    assert main([*command, "--workers", "1", "--figure-format", "pdf,png"]) == 0
    stems = {"ate_position_m", "ate_rotation_deg"}
    for sequence in ("hall", "yard"):
        stems |= {f"re_position_percent_{sequence}", f"re_rotation_deg_{sequence}"}
        stems |= {f"trajectories_{sequence}", f"errors_{sequence}"}
    names = {f"{stem}.{suffix}" for stem in stems for suffix in ("pdf", "png")}
    assert {each.name for each in (out / "figures").iterdir()} == names


def test_what_is_for_files_needs_a_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_runs(tmp_path)
    assert main(["compare", str(config), "--figure-width", "3.5"]) == 2
    assert "--figure-format" in capsys.readouterr().err


def test_a_single_trial_is_a_dot_and_several_are_a_box() -> None:
    with house_style():
        one, two, pooled = (
            box_plot(BoxPlot(["hall"], [("vio", [box])], "", "m")).axes[0]
            for box in (Box.of([0.3]), Box.of([0.3, 0.5]), Box(0.1, 0.2, 0.3, 0.4, 0.5))
        )
    assert not one.patches
    assert [each.get_ydata().tolist() for each in one.lines if each.get_marker() == "o"] == [[0.3]]
    assert len(two.patches) == 1
    assert len(pooled.patches) == 1


@pytest.mark.parametrize("sequences", [1, 11])
@pytest.mark.parametrize("algorithms", [1, 5])
@pytest.mark.parametrize("width", ["ieee-column", "ieee-page"])
def test_names_below_boxes_do_not_run_into_each_other(
    sequences: int, algorithms: int, width: str
) -> None:
    groups = [f"MH_{each:02d}_difficult" for each in range(sequences)]
    series = [
        (f"vio_{each}", [Box.of([0.1, 0.2 + each])] * sequences) for each in range(algorithms)
    ]
    with house_style(FigureStyle.parse(None, width, None, has_titles=True)):
        figure = box_plot(BoxPlot(groups, series, "", "position [m]"))
        figure.draw_without_rendering()
        (axes,) = figure.axes
        labels = [each.get_window_extent() for each in axes.get_xticklabels()]
        rotated = axes.get_xticklabels()[0].get_rotation() != 0.0
        if not rotated:
            assert not any(a.x1 > b.x0 for a, b in pairwise(labels))
        assert figure.get_tightbbox().x0 >= -0.02


def test_errors_and_paths_of_many_algorithms_have_panels_and_keep_their_colours() -> None:
    time = np.linspace(0.0, 10.0, 50)
    errors = np.stack([time, 0.1 * time, np.full(50, np.nan)], axis=1)
    truth = np.stack([np.cos(time), np.sin(time), 0.0 * time], axis=1)
    places = (0, 1, 3, 4)  # the third has no run here
    with house_style():
        shown = errors_over_time(ErrorsPlot({each: (f"vio_{each}", errors) for each in places}))
        paths = overlay(PathsPlot(Z_UP, truth, {each: (f"vio_{each}", truth) for each in places}))
        single = errors_over_time(ErrorsPlot({3: ("vio_3", errors)}))
    colours = [axes.title.get_color() for axes in paths.axes if axes.get_visible()]
    assert colours == ["#d55e00", "#0072b2", "#cc79a7", "#e69f00"]
    assert len(shown.axes) == 8
    assert single.axes[0].lines[0].get_color() == "#cc79a7"


@pytest.mark.parametrize(
    ("width", "rows"), [("ieee-column", [2, 2, 1]), ("ieee-page", [3, 2])], ids=["narrow", "wide"]
)
def test_five_paths_fill_rows_evenly_and_the_lowest_of_each_column_is_labelled(
    width: str, rows: list[int]
) -> None:
    angle = np.linspace(0.0, 6.0, 50)
    truth = np.stack([np.cos(angle), 0.8 * np.sin(angle), 0.0 * angle], axis=1)
    with house_style(FigureStyle.parse(None, width, None, has_titles=True)):
        paths = {each: (f"vio_{each}", truth) for each in range(5)}
        figure = canvas.titled(
            partial(overlay, PathsPlot(Z_UP, truth, paths)), "Trajectories on hall"
        )
        figure.draw_without_rendering()
        shown = [axes for axes in figure.axes if axes.get_visible()]
        boxes = [axes.get_window_extent() for axes in shown]
        heights = sorted({round(box.y0) for box in boxes}, reverse=True)
        assert [sum(round(box.y0) == each for box in boxes) for each in heights] == rows
        for axes, box in zip(shown, boxes, strict=True):
            below = any(round(other.x0) == round(box.x0) and other.y0 < box.y0 for other in boxes)
            assert axes.get_xlabel() == ("" if below else "x [m]")
            assert any(each.label1.get_visible() for each in axes.xaxis.get_major_ticks()) != below
        title = figure.texts[0].get_window_extent()
        assert all(axes.title.get_window_extent().y1 <= title.y0 for axes in shown)


def test_dots_of_trials_are_alike_whatever_their_number() -> None:
    series = [("vio", [Box.of([0.3, 0.5]), None]), ("slam", [Box.of([0.4]), Box.of([0.6])])]
    with house_style():
        axes = box_plot(BoxPlot(["hall", "yard"], series, "", "m")).axes[0]
    dots = [each for each in axes.lines if each.get_marker() == "o"]
    assert len({each.get_markersize() for each in dots}) == 1
    # Groups are told apart by a line between them.
    assert [0.5, 0.5] in [np.asarray(each.get_xdata()).tolist() for each in axes.lines]


def test_who_covers_less_than_the_others_is_never_the_best(tmp_path: Path) -> None:
    config = write_runs(tmp_path, sequences=("hall",), trials=1)
    write_run(tmp_path / "good" / "hall_trial0.txt", 1.001, count=150, seconds=10.0)
    out = tmp_path / "out"
    assert main(["compare", str(config), "--output", str(out), "--quiet", "--workers", "1"]) == 0
    absolute, *_, relative = matrices(summary_of(out))[:3]
    for table in (absolute, relative):
        cells = dict(table.rows)
        good, bad = cells["good"][0], cells["bad"][0]
        assert good.value is not None
        assert bad.value is not None
        assert good.value < bad.value
        assert (good.is_ranked, bad.is_ranked) == (False, True)
    assert absolute.ranks() == [[0], [1]]
    ranked = "Most sequences with the smallest position ATE of those that are ranked: bad, on 1"
    assert ranked in (out / "report.html").read_text()
    # Where all cover as little, they compare.
    write_run(tmp_path / "bad" / "hall_trial0.txt", 1.03, count=150, seconds=10.0)
    assert main(["compare", str(config), "--output", str(out), "--quiet", "--workers", "1"]) == 0
    assert matrices(summary_of(out))[0].ranks() == [[1], [2]]
    assert "smallest position ATE: good, on 1" in (out / "report.html").read_text()
