from __future__ import annotations

import dataclasses
import io
import sys
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting import palette
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol, metres
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.report import canvas
from trajeval_ros.report.figure_output import save_all
from trajeval_ros.report.figure_style import FigureStyle, apply_style
from trajeval_ros.report.figures import draw, evaluation_drawings
from trajeval_ros.report.line_thinning import MOST_POINTS, thinned
from trajeval_ros.simulation.drifting_odometry import simulate

is_gap = AssociationRule().is_gap

pytest.importorskip("matplotlib", reason="figures need the extra `plot`")

ALL = [
    "trajectory_top.png",
    "trajectory_side.png",
    "absolute_error.png",
    "relative_error.png",
]


def _evaluation(
    seed: int = 0, protocol: Protocol | None = None, **groundtruth: object
) -> Evaluation:
    flight = simulate(seed, 40.0)
    truth = dataclasses.replace(flight.groundtruth, **groundtruth)
    estimate = dataclasses.replace(flight.estimate, name=f"vio {seed}")
    return evaluate(truth, estimate, protocol or Protocol(gauge=Gauge.YAW))


def _pixels(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return imread(path)[:, :, :3]


def _texts(evaluations: list[Evaluation], draw: str) -> str:
    """All words of a figure: titles, labels, legends and notes."""
    from matplotlib.text import Text

    from trajeval_ros.report import absolute_figure, relative_figure, trajectory_figure

    for module in (absolute_figure, relative_figure, trajectory_figure):
        if hasattr(module, draw):
            names = canvas.short_names([evaluation.estimate.name for evaluation in evaluations])
            with apply_style():
                figure = getattr(module, draw)(evaluations, names)
                figure.canvas.draw()
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def _colour_share(pixels: np.ndarray, colour: str) -> float:
    expected = np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)]) / 255.0
    return float(np.mean(np.abs(pixels - expected).max(axis=2) < 0.02))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The figures of `_evaluation()`."""
    return save_all(
        evaluation_drawings([_evaluation()]), tmp_path_factory.mktemp("figures"), FigureStyle()
    )


@pytest.mark.slow
def test_writes_every_figure_and_none_is_blank(drawn: list[Path]) -> None:
    assert [path.name for path in drawn] == ALL
    for path in drawn:
        pixels = _pixels(path)
        assert pixels.std() > 0.05
        assert min(pixels.shape[:2]) > 200
        assert _colour_share(pixels, palette.ESTIMATES[0]) > 5e-4


@pytest.mark.slow
def test_same_evaluation_gives_the_same_bytes(drawn: list[Path], tmp_path: Path) -> None:
    again = save_all(evaluation_drawings([_evaluation()]), tmp_path, FigureStyle())
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in drawn]


def test_what_the_user_has_set_goes_before_our_style_and_a_style_sheet_before_both(
    tmp_path: Path,
) -> None:
    import matplotlib

    sheet = tmp_path / "ours.mplstyle"
    sheet.write_text("axes.facecolor: green\n")
    with matplotlib.rc_context({"axes.facecolor": "red", "font.size": 8.5}):
        with apply_style():
            assert matplotlib.rcParams["axes.facecolor"] == "red"
            assert matplotlib.rcParams["font.size"] == 8.5
            assert matplotlib.rcParams["axes.labelsize"] == 8.0
        with apply_style(FigureStyle(file=sheet, width_in=3.5)):
            assert matplotlib.rcParams["axes.facecolor"] == "green"
            assert matplotlib.rcParams["font.size"] == 8.5
            assert matplotlib.rcParams["figure.figsize"][0] == 3.5
        assert matplotlib.rcParams["axes.facecolor"] == "red"
    with apply_style(), matplotlib.rc_context():
        assert matplotlib.rcParams["axes.facecolor"] == "white"


@pytest.mark.slow
def test_more_estimates_than_colours(tmp_path: Path) -> None:
    assert len(save_all(evaluation_drawings([_evaluation()] * 8), tmp_path, FigureStyle())) == 4
    with apply_style():
        assert len({canvas.line_style(place) for place in range(20)}) == 20


def test_titles_state_the_definitions() -> None:
    evaluation = _evaluation()
    absolute = _texts([evaluation], "absolute_error")
    assert f"all {len(evaluation.association)} pairs" in absolute
    assert "yaw and position" in absolute
    assert "position difference" in absolute
    assert f"RMSE {evaluation.ate['position_m'].rmse:.3g} m" in absolute
    assert f"{round(100 * evaluation.association.groundtruth_coverage)} % covered" in absolute
    assert "position error [m]" in absolute
    assert "distance travelled [m]" in absolute
    relative = _texts([evaluation], "relative_error")
    assert "at the first state by yaw and position" in relative
    assert str(evaluation.relative[0].statistics["position_m"].count) in relative
    first = _evaluation(protocol=Protocol(gauge=Gauge.SE3, align_states=1, re_form="se3"))
    assert "position (SE(3)), gauge se3, the first pair" in _texts([first], "top_view")
    assert "by SE(3)" in _texts([first], "relative_error")


@pytest.mark.slow
def test_withheld_rotation_says_why(tmp_path: Path) -> None:
    without = _evaluation(quaternions=None)
    assert len(save_all(evaluation_drawings([without]), tmp_path, FigureStyle())) == 4
    assert "no orientations in the groundtruth" in _texts([without], "absolute_error")
    assert "fitted to every" not in _texts([_evaluation()], "relative_error")
    assert "vertical error [m]" in _texts([without], "absolute_error")
    both = _texts([_evaluation(), without], "absolute_error")
    assert "withheld" in both


def test_undetermined_rotation_says_why() -> None:
    flight = simulate(0, 40.0)
    line = flight.groundtruth.positions * [1.0, 0.0, 0.0]
    straight = dataclasses.replace(flight.groundtruth, positions=line)
    evaluation = evaluate(straight, straight[::10], Protocol(gauge=Gauge.SE3))
    assert evaluation.alignment.undetermined
    assert "do not determine" in _texts([evaluation], "absolute_error")


@pytest.mark.slow
def test_no_sub_trajectory_of_the_lengths(tmp_path: Path) -> None:
    evaluation = _evaluation(protocol=Protocol(gauge=Gauge.YAW, lengths=metres(1000)))
    assert len(save_all(evaluation_drawings([evaluation]), tmp_path, FigureStyle())) == 4
    assert "No sub-trajectories of 1000 m" in _texts([evaluation], "relative_error")
    part = _evaluation(protocol=Protocol(gauge=Gauge.YAW, lengths=metres(8, 1000)))
    assert "\n0\n" in _texts([part], "relative_error")


def test_relative_error_in_seconds_and_shares() -> None:
    lengths = (Length(1, "s"), Length(5, "s"))
    seconds = _texts([_evaluation(protocol=Protocol(lengths=lengths))], "relative_error")
    assert "length of sub-trajectory [s]" in seconds
    assert "% of length" not in seconds
    lengths = (Length(10, "%"), Length(2, "m"))
    mixed = _texts([_evaluation(protocol=Protocol(lengths=lengths))], "relative_error")
    assert "10 %" in mixed
    assert "2 m" in mixed


@pytest.mark.slow
def test_errors_that_do_not_exist_have_no_panel() -> None:
    without = _evaluation(quaternions=None)
    assert "rotation error [deg]" not in _texts([without], "relative_error")
    assert "rotation error [deg]" in _texts([without, _evaluation()], "relative_error")


@pytest.mark.parametrize(
    ("label", "lines"),
    [
        ("openvins/MH_01_with_covariance", ["openvins/MH_01_with_", "covariance"]),
        (" _hidden/name_of_a_run", [" _hidden/name_of_a_", "run"]),
        ("nowhere" * 4, ["nowhere" * 2 + "nowher", "enowhere"]),
        ("a name, RMSE 0.123 m", ["a name, RMSE 0.123 m"]),
        ("a name, RMSE 0.123 m, 99 %", ["a name, RMSE 0.123 ", "m, 99 %"]),
    ],
)
def test_names_are_wrapped_between_their_parts(label: str, lines: list[str]) -> None:
    room_in = 0.06 * (20 + 7) + 1e-6  # 20 characters and the handle of a legend
    assert canvas.wrapped(label, room_in).split("\n") == lines


@pytest.mark.slow
def test_what_was_not_asked_for_is_not_drawn(tmp_path: Path) -> None:
    planar = _evaluation(protocol=Protocol(gauge=Gauge.PLANAR, lengths=()))
    names = [
        path.name for path in save_all(evaluation_drawings([planar]), tmp_path, FigureStyle())
    ]
    assert names == ["trajectory_top.png", "absolute_error.png"]


@pytest.mark.slow
def test_one_state_at_rest_can_be_drawn(tmp_path: Path) -> None:
    state = simulate(0, 5.0).groundtruth[:1]
    evaluation = evaluate(state, state, Protocol(gauge=Gauge.TRANSLATION))
    assert len(save_all(evaluation_drawings([evaluation]), tmp_path, FigureStyle())) == 4


def test_without_matplotlib_the_error_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match="pip install"):
        save_all(evaluation_drawings([_evaluation()]), tmp_path, FigureStyle())
    assert not list(tmp_path.iterdir())


def test_thinning_keeps_peaks_and_ends_and_breaks_at_gaps() -> None:
    count = 1_000_000
    stamps = 5_000_000 * np.arange(count)
    stamps[600_000:] += 3_000_000_000
    columns = np.stack([np.arange(count, dtype=float), np.zeros(count)], axis=1)
    columns[123_457, 1] = 7.0
    thin = thinned(columns, stamps, is_gap)
    assert len(thin) <= MOST_POINTS + 10
    assert np.nanmax(thin[:, 1]) == 7.0
    assert (thin[0, 0], thin[-1, 0]) == (0.0, count - 1.0)
    (gap,) = np.flatnonzero(np.isnan(thin[:, 0]))
    assert (thin[gap - 1, 0], thin[gap + 1, 0]) == (599_999.0, 600_000.0)
    assert (np.diff(thin[~np.isnan(thin[:, 0]), 0]) > 0).all()


def test_keyframes_far_apart_are_no_gaps() -> None:
    stamps = 2_000_000_000 * np.arange(10)
    columns = np.zeros((10, 2))
    np.testing.assert_array_equal(thinned(columns, stamps, is_gap), columns)


def test_long_and_missing_names() -> None:
    short, missing = canvas.short_names(["a/" * 60 + "odometry", ""])
    assert short.startswith("…")
    assert short.endswith("/odometry")
    assert len(short) <= 48
    assert missing == "estimate 2"


@pytest.mark.slow
def test_names_are_neither_hidden_nor_read_as_formulas() -> None:
    evaluation = _evaluation()
    for name in ("_hidden", "$run_{1$", "50%"):
        named = dataclasses.replace(evaluation.estimate, name=name)
        odd = dataclasses.replace(evaluation, estimate=named)
        for drawing in ("absolute_error", "relative_error", "top_view"):
            assert name in _texts([odd], drawing)


@pytest.mark.slow
def test_large_coordinates_keep_the_figure_small(tmp_path: Path) -> None:
    flight = simulate(0, 20.0)
    far = flight.groundtruth.positions * [100.0, 1.0, 1.0] + [5e5, 4e6, 0.0]
    truth: Trajectory = dataclasses.replace(flight.groundtruth, positions=far)
    paths = save_all(evaluation_drawings([evaluate(truth, truth[::10])]), tmp_path, FigureStyle())
    assert len(paths) >= 4
    for path in paths:
        assert max(_pixels(path).shape) < 2600


def test_boxes_and_whiskers_are_what_the_title_says() -> None:
    from trajeval_ros.report.relative_figure import relative_error

    evaluation = _evaluation()
    assert evaluation.relative is not None
    with apply_style():
        figure = relative_error([evaluation], ["vio"])
    assert "boxes: median and quartiles; whiskers: 5 % to 95 %" in figure.get_suptitle()
    (axes,) = (axis for axis in figure.axes if axis.get_ylabel() == "position error [m]")
    # Of a whisker the ends are its percentile and the quartile.
    ends = {
        (round(float(line.get_xdata()[0])), float(end))
        for line in axes.lines
        for end in line.get_ydata()
    }
    for place, segments in enumerate(evaluation.relative):
        drawn = sorted(end for group, end in ends if group == place)
        assert drawn == pytest.approx(
            np.percentile(segments.errors.position_m, [5, 25, 50, 75, 95])
        )


def test_a_doubted_vertical_axis_gives_no_top_view() -> None:
    flight = simulate(seed=3, duration_s=40.0)
    sides = (flight.groundtruth, flight.estimate)
    assert "Top view (x, y)" in _texts([evaluate(*sides)], "top_view")
    # The body turns about y now: the plane of x and y is not horizontal.
    rotated = Similarity(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
    doubted = evaluate(*(rotated.trajectory(side) for side in sides))
    assert any(remark.code == "up_axis_doubted" for remark in doubted.remarks)
    assert "Paths (x, y)" in _texts([doubted], "top_view")
    assert "Paths (" in _texts([doubted], "side_view")


def test_a_notebook_shows_a_figure_without_a_backend() -> None:
    from PIL import Image

    figure = draw(_evaluation(), "top")
    shown = Image.open(io.BytesIO(figure._repr_png_()))  # type: ignore[attr-defined]
    assert shown.format == "PNG"
    assert shown.size[0] > 600
    assert np.asarray(shown.convert("L")).std() > 5.0
