"""Figures of a comparison as SVG: what is drawn where, how small it is, and what an axis says."""

from __future__ import annotations

import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.report.canvas import common_offset, tick_labels, tick_places
from trajeval_ros.report.comparison_figures import (
    Box,
    BoxPlot,
    ErrorsPlot,
    PathsPlot,
    box_figure,
    errors_figure,
    figure_of,
    kind_of,
    paths_figure,
    run_errors_svg,
    run_path_svg,
)
from trajeval_ros.report.line_thinning import MOST_POINTS, simplified
from trajeval_ros.report.svg_figure import Picture, SvgFigure
from trajeval_ros.report.svg_panel import LINE_PX, SvgPanel, text_width


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
@example(1.0, 7999999.0, 3)  # four by steps of 2e6, and one by steps of 5e6
def test_ticks_are_round_few_and_within(low: float, span: float, most: int) -> None:
    high = low + span
    places = tick_places(low, high, most)
    assert 2 <= len(places) <= max(most, 5)
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
    assert common_offset(4_500_003.25, 4_500_003.75) == 4_500_003.0
    assert common_offset(4_500_003.25, 4_500_003.25) == pytest.approx(4_500_003.25, abs=1e-6)
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
        assert distances_to_line(shown, drawn).max() <= 0.1 + 0.08  # rounded to tenths of a pixel
        return
    for column in np.unique(np.floor(points[:, 0] / 2.0)):
        inside = shown[np.floor(points[:, 0] / 2.0) == column]
        of_column = drawn[np.abs(drawn[:, 0] - 2.0 * column - 1.0) <= 1.06]
        assert of_column[:, 1].min() <= inside[:, 1].min() + 0.06
        assert of_column[:, 1].max() >= inside[:, 1].max() - 0.06


@given(
    arrays.arrays(float, st.tuples(st.integers(1, 80), st.just(3)), elements=st.floats(-9.0, 9.0)),
    st.floats(0.001, 3.0),
    st.sets(st.integers(0, 78), max_size=4),
)
def test_a_simplified_path_stays_within_its_tolerance(
    path: Floats, tolerance_m: float, gaps: set[int]
) -> None:
    steps = np.where(np.isin(np.arange(len(path)), list(gaps)), 10**10, 10**8)
    stamps = np.cumsum(steps)
    left = simplified(path, stamps, 0.5, tolerance_m)
    pieces = np.split(path, np.flatnonzero(np.diff(stamps) > 10**9) + 1)
    ends = np.flatnonzero(np.isnan(left[:, 0]))
    found = [piece[np.isfinite(piece[:, 0])] for piece in np.split(left, ends)]
    assert len(found) == len(pieces)
    for piece, rows in zip(pieces, found, strict=True):
        np.testing.assert_array_equal(rows[[0, -1]], piece[[0, -1]])
        assert (rows[:, None] == piece[None]).all(axis=2).any(axis=1).all()
        assert distances_to_line(piece[:, :2], rows[:, :2]).max() <= tolerance_m * (1.0 + 1e-9)


@pytest.mark.slow
def test_a_simplified_path_has_few_rows() -> None:
    turns = np.linspace(0.0, 2.0 * np.pi, 100_000)
    circle = np.stack([np.cos(turns), np.sin(turns), turns], axis=1)
    # A chord of a circle is at most 1 - cos(a / 2) away from it.
    rows = simplified(circle, 10**7 * np.arange(len(circle)), 0.5, 1e-4)
    assert 2.0 * np.pi / np.arccos(1.0 - 1e-4) / 2.0 <= len(rows) <= 4.0 * np.pi / 0.0141
    noise = np.random.default_rng(1).normal(size=(60_000, 3))
    assert len(simplified(noise, 10**7 * np.arange(60_000), 0.5, 0.0)) <= MOST_POINTS


def distances_to_line(points: Floats, line: Floats) -> Floats:
    """Return the distances (N,) of points (N, 2) from a line of M vertices (M, 2)."""
    start, along = line[:-1], np.diff(line, axis=0)
    if not len(along):
        alone: Floats = np.hypot(*(points - line[0]).T)
        return alone
    beside = points[:, None] - start
    share = (beside * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    away: Floats = np.linalg.norm(
        beside - np.clip(share, 0.0, 1.0)[..., None] * along, axis=2
    ).min(axis=1)
    return away


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
    assert not any("<path" in part for part in panel.parts)


def test_boxes_stand_where_their_values_are() -> None:
    series = [("one", [Box(1.0, 2.0, 3.0, 4.0, 5.0), None]), ("two", [Box.of([4.0]), None])]
    figure = parsed(box_figure(BoxPlot(["hall", "yard"], series, "", "position [m]")).to_html())
    numbers = {each.text: float(each.get("y", "nan")) - 4.0 for each in figure.iter("text")}
    pixels = (numbers["0"] - numbers["4"]) / 4.0  # of one metre
    (middle,) = (each for each in figure.iter("path") if each.get("class") == "d")
    at = float(re.findall(r"M\S+ (\S+)H", str(middle.get("d")))[0])
    assert at == pytest.approx(numbers["0"] - 3.0 * pixels, abs=0.2)
    (dot,) = figure.iter("circle")
    assert dot.get("class") == f"p {kind_of(1)}"
    assert float(dot.get("cy", "nan")) == pytest.approx(numbers["4"], abs=0.2)
    keys = [each.text for each in figure.iter("button")]
    assert keys == ["one", "two"]


def test_many_boxes_are_in_rows_and_many_points_are_none() -> None:
    names = [f"sequence_{each}" for each in range(30)]
    many = [Box.of(np.linspace(0.1, 0.9, 21).tolist()) for _ in names]
    plot = BoxPlot(names, [(f"a{each}", many) for each in range(8)], "", "m")
    drawn = box_figure(plot).to_html()
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
        figure = parsed(paths_figure(PathsPlot(Z_UP, path, paths)).to_html())
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


def test_a_single_trial_is_a_dot_and_several_are_a_box() -> None:
    one, two, pooled = (
        box_figure(BoxPlot(["hall"], [("vio", [box])], "", "m")).to_html()
        for box in (Box.of([0.3]), Box.of([0.3, 0.5]), Box(0.1, 0.2, 0.3, 0.4, 0.5))
    )
    assert [text.count('class="b ') for text in (one, two, pooled)] == [0, 1, 1]
    assert [text.count("<circle") for text in (one, two, pooled)] == [1, 2, 0]


def test_dots_of_trials_are_alike_whatever_their_number() -> None:
    series = [("vio", [Box.of([0.3, 0.5]), None]), ("slam", [Box.of([0.4]), Box.of([0.6])])]
    figure = parsed(box_figure(BoxPlot(["hall", "yard"], series, "", "m")).to_html())
    assert len({each.get("r") for each in figure.iter("circle")}) == 1


@pytest.mark.parametrize("sequences", [1, 11])
@pytest.mark.parametrize("algorithms", [1, 5])
def test_names_below_boxes_do_not_run_into_each_other(sequences: int, algorithms: int) -> None:
    groups = [f"MH_{each:02d}_difficult" for each in range(sequences)]
    series = [
        (f"vio_{each}", [Box.of([0.1, 0.2 + each])] * sequences) for each in range(algorithms)
    ]
    figure = parsed(box_figure(BoxPlot(groups, series, "", "position [m]")).to_html())
    names = [each for each in figure.iter("text") if str(each.text).startswith("MH")]
    assert [each.text for each in names] == groups
    if all(each.get("x") for each in names):  # otherwise they are rotated
        ends = [(float(str(each.get("x"))), text_width(str(each.text)) / 2.0) for each in names]
        assert all(a + half <= b - other for (a, half), (b, other) in pairwise(ends))


def test_errors_and_paths_of_many_algorithms_have_panels_and_keep_their_colours() -> None:
    time = np.linspace(0.0, 10.0, 50)
    errors = np.stack([time, 0.1 * time, np.full(50, np.nan)], axis=1)
    turned = np.stack([time, 0.1 * time, 0.2 * time], axis=1)
    path = np.stack([np.cos(time), np.sin(time), 0.0 * time], axis=1)
    places = (0, 1, 3, 4)  # the third has no run here
    paths = paths_figure(PathsPlot(Z_UP, path, {each: (f"vio_{each}", path) for each in places}))
    shown = errors_figure(ErrorsPlot({each: (f"vio_{each}", turned) for each in places}))
    for figure in (paths, shown):
        assert [(each.name, each.kind) for each in figure.pictures] == [
            (f"vio_{each}", f"s{each}") for each in places
        ]
    assert [len(each.panels) for each in shown.pictures] == [2] * 4
    single = errors_figure(ErrorsPlot({3: ("vio_3", errors), 8: ("vio_8", turned)}))
    (picture,) = single.pictures
    assert len(picture.panels) == 2
    assert single.keys == [("s3", "vio_3"), ("s2 d1", "vio_8")]
    lines = re.findall(r'class="c ([^"]*)"', picture.content)
    assert lines == ["s3", "s2 d1", "s2 d1"]  # one rotation is withheld
    assert len(errors_figure(ErrorsPlot({3: ("vio_3", errors)})).pictures[0].panels) == 1


def test_a_file_needs_no_styles_of_a_page() -> None:
    time = np.linspace(0.0, 10.0, 50)
    path = np.stack([np.cos(time), np.sin(time), 0.0 * time], axis=1)
    boxes = [Box.of([0.1, 0.2])]
    for count in (1, 3, 9):
        plots = (
            BoxPlot(["hall"], [(f"vio <{each}>", boxes) for each in range(count)], "", "m"),
            PathsPlot(Z_UP, path, {each: (f"vio <{each}>", path) for each in range(count)}),
            ErrorsPlot({each: (f"vio <{each}>", path**2) for each in range(count)}),
        )
        for plot in plots:
            text = figure_of(plot).to_file("A & B")
            root = ElementTree.fromstring(text)
            inside = "{http://www.w3.org/2000/svg}"
            title, style = root.find(f"{inside}title"), root.find(f"{inside}style")
            assert title is not None
            assert title.text == "A & B"
            assert style is not None
            assert not re.search(r"var\(|color-mix|currentColor", text)
            kinds = " ".join(re.findall(r'class="([^"]*)"', text)).split()
            assert {f".{each}" for each in kinds} <= set(
                re.findall(r"\.[a-z]+\d*", str(style.text))
            )
            shown = [each.text for each in root.iter(f"{inside}text")]
            assert {f"vio <{each}>" for each in range(count)} <= set(shown)
            wide, high = (float(str(root.get(each))) for each in ("width", "height"))
            assert root.get("viewBox") == f"0 0 {wide:g} {high:g}"
            for group in root.findall(f"{inside}g"):
                x, y = map(float, re.findall(r"[\d.]+", str(group.get("transform"))))
                assert x < wide
                assert y < high


def test_lines_of_a_legend_are_before_their_names() -> None:
    """Rows are filled from the left; lines have tenths of pixels."""
    keys = [(f"s{number}", f"an estimate with a long name {number}") for number in range(5)]
    names = {name for _, name in keys}
    tree = ElementTree.fromstring(SvgFigure(keys, []).to_file("legend"))
    space = "{http://www.w3.org/2000/svg}"
    texts = [each for each in tree.iter(f"{space}text") if each.text in names]
    lines = [each for each in tree.iter(f"{space}path") if each.get("transform") == "scale(.1)"]
    assert [each.text for each in texts] == [name for _, name in keys]
    places = []
    for line, text in zip(lines, texts, strict=True):
        x, y, wide = map(float, re.findall(r"[\d.]+", str(line.get("d"))))
        left, base = float(text.attrib["x"]), float(text.attrib["y"])
        assert x / 10.0 == pytest.approx(left - 28.0, abs=0.1)
        assert wide / 10.0 == pytest.approx(22.0)
        assert y / 10.0 == pytest.approx(base - 4.0)
        places.append((base, x))
    assert places == sorted(places)
    assert len({base for base, _ in places}) > 1
    assert {x for base, x in places if base == places[0][0]} > {120.0}


def test_pictures_of_a_file_fill_rows_below_their_names() -> None:
    """Of 480 px: two of 200 px, one below, and the highest decides where the next row is."""
    sizes = [(200.0, 100.0), (200.0, 140.0), (300.0, 50.0)]
    for names, above in ((("a", "b", "c"), LINE_PX + 4.0), (("", "", ""), 0.0)):
        pictures = [
            Picture([], size, "", name, "s0") for size, name in zip(sizes, names, strict=True)
        ]
        tree = ElementTree.fromstring(SvgFigure([("s0", "vio")], pictures).to_file("t"))
        space, top = "{http://www.w3.org/2000/svg}", LINE_PX + 4.0
        second = top + 140.0 + above
        moves = [str(each.get("transform")) for each in tree.findall(f"{space}g")]
        assert [tuple(map(float, re.findall(r"[\d.]+", each))) for each in moves] == [
            (0.0, top + above),
            (200.0, top + above),
            (0.0, second + above),
        ]
        assert float(str(tree.get("height"))) == second + above + 50.0
        texts = [each for each in tree.findall(f"{space}text") if each.text in names]
        assert [(float(each.attrib["x"]), float(each.attrib["y"])) for each in texts] == (
            [(12.0, top + LINE_PX), (212.0, top + LINE_PX), (12.0, second + LINE_PX)]
            if above
            else []
        )
