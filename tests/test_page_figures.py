"""Figures as SVG for a page: what is drawn where, how small it is, and what an axis says."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.report.comparison_plots import Box, BoxPlot, PathsPlot
from trajeval_ros.report.page_figures import (
    box_svg,
    kind_of,
    paths_svg,
    run_errors_svg,
    run_path_svg,
)
from trajeval_ros.report.svg_panel import SvgPanel
from trajeval_ros.report.ticks import common_offset, tick_labels, tick_places


def parsed(svg: str) -> ElementTree.Element:
    return ElementTree.fromstring(f"<div>{svg}</div>")


def points_of(panel: SvgPanel) -> list[Floats]:
    """Return the ends of the steps of each piece of the only line, in pixels."""
    (path,) = re.findall(r' d="([^"]*)"', "".join(panel.parts))
    pieces = []
    for piece in path.split("M")[1:]:
        numbers = np.array(re.findall(r"-?\d+", piece), dtype=float).reshape(-1, 2)
        pieces.append(np.cumsum(numbers, axis=0) / 10.0)
    return pieces


@given(st.floats(-1e7, 1e7), st.floats(1e-3, 1e7), st.integers(3, 9))
def test_ticks_are_round_few_and_within(low: float, span: float, most: int) -> None:
    high = low + span
    places = tick_places(low, high, most)
    assert 2 <= len(places) <= most
    steps = np.diff(places)
    scale = max(abs(low), abs(high))
    assert np.ptp(steps) <= 1e-12 * scale
    first = f"{steps[0]:e}"
    assert first.startswith(("1.", "2.", "5.", "9.99", "4.99", "1.99"))
    slack = 1e-8 * max(span, scale * 1e-6)
    assert places[0] >= low - slack
    assert places[-1] <= high + slack
    labels = tick_labels(places)
    assert len(set(labels)) == len(labels)
    values = [float(label.replace("\u2212", "-")) for label in labels]
    np.testing.assert_allclose(values, places, rtol=1e-5, atol=1e-9 + 0.02 * steps[0])


def test_labels_have_as_many_decimals_as_their_step_needs() -> None:
    assert tick_labels([0.0, 0.05, 0.1]) == ["0.00", "0.05", "0.10"]
    assert tick_labels([-5.0, 0.0, 5.0]) == ["\u22125", "0", "5"]
    assert tick_places(1.0, 1.0, 5) == []


def test_large_coordinates_lose_what_they_have_in_common() -> None:
    assert common_offset(-20.0, 30.0) == 0.0
    assert common_offset(4_500_010.0, 4_500_090.0) == 4_500_000.0
    path = np.array([[4_500_010.0, 10.0, 0.0], [4_500_090.0, 40.0, 0.0]])
    texts = [each.text for each in parsed(run_path_svg(0, Z_UP, path, path)).iter("text")]
    assert "x \u2212 4500000 [m]" in texts
    assert "y [m]" in texts
    assert "20" in texts


@given(
    arrays.arrays(
        float, st.tuples(st.integers(1, 300), st.just(2)), elements=st.floats(0.0, 100.0)
    ),
    st.booleans(),
)
def test_a_line_is_thinned_by_less_than_can_be_seen(points: Floats, over_time: bool) -> None:
    if over_time:
        points = points[np.argsort(points[:, 0], kind="stable")]
    panel = SvgPanel((0.0, 0.0), (100.0, 100.0), (0.0, 100.0), (0.0, 100.0))
    panel.line(points, "s0", over_time=over_time)
    (drawn,) = points_of(panel)
    shown = np.column_stack([points[:, 0], 100.0 - points[:, 1]])
    # Nothing is drawn that isn't there, and each point is near one that is drawn.
    away = np.abs(shown[:, None] - drawn[None]).max(axis=2)
    assert away.min(axis=0).max() <= 0.06
    if not over_time:
        assert away.min(axis=1).max() <= 1.06
        return
    for column in np.unique(np.floor(points[:, 0] / 2.0)):
        inside = shown[np.floor(points[:, 0] / 2.0) == column]
        of_column = drawn[np.abs(drawn[:, 0] - 2.0 * column - 1.0) <= 1.06]
        assert of_column[:, 1].min() <= inside[:, 1].min() + 0.06
        assert of_column[:, 1].max() >= inside[:, 1].max() - 0.06


def test_a_line_is_broken_where_it_says_so() -> None:
    points = np.array([[0.0, 0.0], [10.0, 5.0], [np.nan, np.nan], [50.0, 5.0], [60.0, 9.0]])
    for over_time in (False, True):
        panel = SvgPanel((0.0, 0.0), (100.0, 10.0), (0.0, 100.0), (0.0, 10.0))
        panel.line(points, "s0", over_time=over_time)
        first, second = points_of(panel)
        np.testing.assert_allclose(first, [[0.0, 10.0], [10.0, 5.0]])
        np.testing.assert_allclose(second, [[50.0, 5.0], [60.0, 1.0]])
    panel = SvgPanel((0.0, 0.0), (100.0, 10.0), (0.0, 100.0), (0.0, 10.0))
    panel.line(np.full((3, 2), np.nan), "s0")
    assert panel.parts == []


def test_boxes_stand_where_their_values_are() -> None:
    series = [("one", [Box(1.0, 2.0, 3.0, 4.0, 5.0), None]), ("two", [Box.of([4.0]), None])]
    figure = parsed(box_svg(BoxPlot(["hall", "yard"], series, "", "position [m]")))
    numbers = {each.text: float(each.get("y", "nan")) - 4.0 for each in figure.iter("text")}
    pixels = (numbers["0"] - numbers["4"]) / 4.0  # of one metre
    (middle,) = (each for each in figure.iter("path") if each.get("class") == "d")
    at = float(re.findall(r"M\S+ (\S+)H", str(middle.get("d")))[0])
    assert at == pytest.approx(numbers["0"] - 3.0 * pixels, abs=0.2)
    (dot,) = figure.iter("circle")
    assert dot.get("class") == f"p {kind_of(1)}"
    assert float(dot.get("cy", "nan")) == pytest.approx(numbers["4"], abs=0.2)
    keys = [each.text for each in figure.iter("span")]
    assert keys == ["one", "two"]


def test_many_boxes_are_in_rows_and_many_points_are_none() -> None:
    names = [f"sequence_{each}" for each in range(30)]
    many = [Box.of(np.linspace(0.1, 0.9, 21).tolist()) for _ in names]
    drawn = box_svg(BoxPlot(names, [(f"a{each}", many) for each in range(8)], "", "m"))
    figure = parsed(drawn)
    assert len(list(figure.iter("svg"))) == 4
    assert "<circle" not in drawn
    assert len(re.findall(r'class="b ', drawn)) == 240
    assert [each.text for each in figure.iter("text") if "sequence" in str(each.text)] == names


def test_colours_come_again_with_dashes() -> None:
    kinds = [kind_of(place) for place in range(24)]
    assert len(set(kinds)) == 24
    assert kinds[0] == "s0"
    assert kinds[6] == "s0 d1"
    assert kind_of(24) == "s0"


def test_many_paths_have_a_panel_each() -> None:
    path = np.column_stack([np.arange(9.0), np.arange(9.0) ** 2, np.zeros(9)])
    for count, panels in ((3, 1), (4, 4)):
        paths = {place: (f"a{place}", path) for place in range(count)}
        figure = parsed(paths_svg(PathsPlot(Z_UP, path, paths)))
        assert len(list(figure.iter("svg"))) == panels


@pytest.mark.parametrize("scale", [0.0, 1.0, 1e-9, 1e9])
def test_runs_of_any_size_are_drawn(scale: float) -> None:
    time = np.linspace(0.0, 10.0, 50) * (scale != 0.0)
    errors = np.column_stack([time, scale * time, np.full(50, np.nan)])
    path = scale * np.column_stack([time, time, time])
    for svg in (run_errors_svg(0, errors), run_path_svg(0, Z_UP, path, path)):
        figure = parsed(svg)
        assert "nan" not in svg
        assert "inf" not in svg
        assert list(figure.iter("path"))
    assert "rotation" not in run_errors_svg(0, errors)


def test_a_run_of_many_poses_is_a_few_kilobytes() -> None:
    random = np.random.default_rng(0)
    path = np.cumsum(random.normal(size=(900, 3)), axis=0)
    errors = np.column_stack([np.arange(900.0), np.abs(random.normal(size=(900, 2)))])
    size = len(run_path_svg(0, Z_UP, path, path)) + len(run_errors_svg(0, errors))
    assert size < 22_000
