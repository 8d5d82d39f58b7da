"""Figures of a comparison: what is drawn where, in which colours, and on a page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need the extra `plot`")

from trajeval_ros.formatting import palette
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.report import canvas
from trajeval_ros.report.comparison_figures import Box, BoxPlot, ErrorsPlot, PathsPlot, figure_of
from trajeval_ros.report.figure_style import FigureStyle, apply_style
from trajeval_ros.report.page_figures import page_figure

WIDTH_IN = 4.6
TIME = np.linspace(0.0, 10.0, 50)
CIRCLE = np.stack([np.cos(TIME), np.sin(TIME), 0.0 * TIME], axis=1)
ERRORS = np.stack([TIME, 0.1 * TIME, 0.2 * TIME], axis=1)
POSITIONS_ONLY = np.stack([TIME, 0.1 * TIME, np.full(50, np.nan)], axis=1)


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with apply_style(FigureStyle(width_in=WIDTH_IN)):
        yield


def boxes_in(axes: Any) -> list[Any]:
    """Return the patches of boxes."""
    from matplotlib.patches import PathPatch

    return [patch for patch in axes.patches if isinstance(patch, PathPatch)]


def dots_in(axes: Any) -> list[Any]:
    """Return the dots of trials."""
    return [line for line in axes.lines if line.get_marker() == "o"]


def test_boxes_stand_where_their_values_are() -> None:
    series = [("one", [Box(1.0, 2.0, 3.0, 4.0, 5.0), None]), ("two", [Box.of([4.0]), None])]
    figure = figure_of(BoxPlot(["hall", "yard"], series, "", "position [m]"))
    (axes,) = figure.axes
    (box,) = boxes_in(axes)
    bounds = box.get_path().get_extents()
    assert (bounds.y0, bounds.y1) == (2.0, 4.0)
    (dot,) = dots_in(axes)
    assert dot.get_ydata() == [4.0]
    assert dot.get_color() == canvas.line_style(1)[0]
    assert axes.get_ylim()[0] == 0.0
    assert [label.get_text() for label in axes.get_xticklabels()] == ["hall", "yard"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["one", "two"]


@pytest.mark.parametrize(("value", "scale"), [(9.9, "linear"), (10.1, "log"), (52.0, "log")])
def test_a_trial_of_ten_times_the_median_makes_the_axis_logarithmic(
    value: float, scale: str
) -> None:
    series = [("a", [Box.of([1.0, 1.0, 1.0])]), ("b", [Box.of([1.0, value])])]
    plot = BoxPlot(["hall"], [*series, ("c", [Box.of([1.0])])], "", "m")
    assert figure_of(plot).axes[0].get_yscale() == scale
    assert plot.is_logarithmic == (scale == "log")


def test_an_error_of_zero_keeps_the_axis_linear() -> None:
    assert not BoxPlot(["hall"], [("a", [Box.of([0.0, 0.1, 99.0])])], "", "m").is_logarithmic


@pytest.mark.slow
def test_many_boxes_are_in_rows_and_many_points_are_none() -> None:
    names = [f"sequence_{number}" for number in range(30)]
    many = [Box.of(np.linspace(0.1, 0.9, 21).tolist()) for _ in names]
    figure = figure_of(BoxPlot(names, [(f"a{number}", many) for number in range(8)], "", "m"))
    assert len(figure.axes) == 4
    assert sum(len(boxes_in(axes)) for axes in figure.axes) == 240
    assert not any(dots_in(axes) for axes in figure.axes)
    labels = [label.get_text() for axes in figure.axes for label in axes.get_xticklabels()]
    assert labels == names


def test_a_single_trial_is_a_dot_and_several_are_a_box() -> None:
    figures = [
        figure_of(BoxPlot(["hall"], [("vio", [box])], "", "m"))
        for box in (Box.of([0.3]), Box.of([0.3, 0.5]), Box(0.1, 0.2, 0.3, 0.4, 0.5))
    ]
    assert [len(boxes_in(figure.axes[0])) for figure in figures] == [0, 1, 1]
    points = [dots_in(figure.axes[0]) for figure in figures]
    assert [sum(len(dots.get_xdata()) for dots in row) for row in points] == [1, 2, 0]


@pytest.mark.parametrize("sequences", [1, 11])
@pytest.mark.parametrize("algorithms", [1, 5])
def test_names_below_boxes_do_not_run_into_each_other(sequences: int, algorithms: int) -> None:
    groups = [f"MH_{number:02d}_difficult" for number in range(sequences)]
    series = [
        (f"vio_{number}", [Box.of([0.1, 0.2 + number])] * sequences)
        for number in range(algorithms)
    ]
    figure = figure_of(BoxPlot(groups, series, "", "position [m]"))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    names = axes.get_xticklabels()
    assert [name.get_text() for name in names] == groups
    if names[0].get_rotation() == 0.0:
        boxes = [name.get_window_extent() for name in names]
        assert all(a.x1 < b.x0 for a, b in pairwise(boxes))
    assert min(name.get_window_extent().y0 for name in names) > 0.0
    assert axes.get_window_extent().height > 60.0  # the names leave room


def test_paths_and_errors_of_many_algorithms_have_panels_and_keep_their_colours() -> None:
    for places, panels in (((0, 1, 4), 1), ((0, 1, 3, 4), 4)):  # some have no run here
        paths = {place: (f"vio_{place}", CIRCLE) for place in places}
        figure = figure_of(PathsPlot(Z_UP, CIRCLE, paths))
        assert len(figure.axes) == panels
        shown = {line.get_color() for axes in figure.axes for line in axes.lines}
        assert {palette.ESTIMATES[place] for place in places} <= shown
        errors = figure_of(ErrorsPlot({place: (f"vio_{place}", ERRORS) for place in places}))
        assert len(errors.axes) == 2 * panels
        shown = {line.get_color() for axes in errors.axes for line in axes.lines}
        assert {palette.ESTIMATES[place] for place in places} <= shown


def test_a_withheld_rotation_has_no_panel_unless_another_one_is_known() -> None:
    assert len(figure_of(ErrorsPlot({3: ("vio", POSITIONS_ONLY)})).axes) == 1
    both = ErrorsPlot({3: ("vio_3", POSITIONS_ONLY), 8: ("vio_8", ERRORS)})
    assert len(figure_of(both).axes) == 2


def test_large_coordinates_lose_what_they_have_in_common() -> None:
    assert canvas.common_offset(-20.0, 30.0) == 0.0
    assert canvas.common_offset(4_500_010.0, 4_500_090.0) == 4_500_000.0
    assert canvas.common_offset(4_500_003.25, 4_500_003.75) == 4_500_003.0
    assert canvas.common_offset(4_500_003.25, 4_500_003.25) == pytest.approx(4_500_003.25)
    path = np.array([[4_500_010.0, 10.0, 0.0], [4_500_090.0, 40.0, 0.0]])
    (axes,) = figure_of(PathsPlot(Z_UP, path, {0: ("vio", path)})).axes
    assert axes.get_xlabel() == "x \u2212 4500000 [m]"
    assert axes.get_ylabel() == "y [m]"


@pytest.mark.parametrize("scale", [0.0, 1.0, 1e-9, 1e9])
def test_runs_of_any_size_are_drawn(scale: float) -> None:
    time = TIME * (scale != 0.0)
    errors = np.column_stack([time, scale * time, np.full(50, np.nan)])
    path = scale * np.column_stack([time, time, time])
    for plot in (ErrorsPlot({0: ("vio", errors)}), PathsPlot(Z_UP, path, {0: ("vio", path)})):
        svg = page_figure(figure_of(plot), "figure")
        assert "nan" not in svg
        assert "inf" not in svg
        assert ElementTree.fromstring(svg) is not None


def test_a_figure_of_a_page_has_the_colours_of_the_page() -> None:
    names = {place: (f"vio <{place}>", CIRCLE) for place in range(3)}
    boxes = BoxPlot(["hall"], [("vio & co", [Box.of([0.1, 0.2])])], "", "position [m]")
    for plot in (PathsPlot(Z_UP, CIRCLE, names), ErrorsPlot({0: ("vio", ERRORS)}), boxes):
        svg = page_figure(figure_of(plot), 'a "title" <b>')
        root = ElementTree.fromstring(svg)
        assert root.get("aria-label") == 'a "title" <b>'
        styles = " ".join(re.findall(r'style="[^"]*"', svg))
        assert "var(--s0)" in styles
        assert "var(--grid)" in styles
        assert not re.findall(r"#[0-9a-f]{6}", styles)
        assert not re.search(r"<(metadata|style)|<g id|<\?xml|<!DOCTYPE", svg)
        texts = {text.text for text in root.iter("{http://www.w3.org/2000/svg}text")}
        assert texts & {"vio <0>", "vio", "vio & co"}


def test_numbers_of_a_figure_keep_their_digits_on_a_page() -> None:
    small = np.stack([TIME, 0.001 * TIME, 0.0002 * TIME], axis=1)
    svg = page_figure(figure_of(ErrorsPlot({0: ("vio 1.23456", small)})), "")
    assert "vio 1.23456" in svg
    assert "0.0005" in svg  # a tick of the rotation
    assert not re.search(r' d="[^"]*\d\.\d{3}', svg)


def test_a_run_of_many_poses_is_less_than_80_kilobytes() -> None:
    random = np.random.default_rng(0)
    path = np.cumsum(random.normal(size=(900, 3)), axis=0)
    errors = np.column_stack([np.arange(900.0), np.abs(random.normal(size=(900, 2)))])
    plots = PathsPlot(Z_UP, path, {0: ("vio", path)}), ErrorsPlot({0: ("vio", errors)})
    assert sum(len(page_figure(figure_of(plot), "")) for plot in plots) < 80_000
