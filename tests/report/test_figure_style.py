"""Figures as they are pasted: formats, widths, sizes of type, titles, styles, many estimates."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting import palette
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip("matplotlib", reason="figures need the extra `plot`")

from matplotlib.image import imread
from matplotlib.text import Text

from trajeval_ros.report import canvas
from trajeval_ros.report.absolute_figure import absolute_error
from trajeval_ros.report.figure_output import save_all
from trajeval_ros.report.figure_style import WIDTHS_IN, FigureStyle, apply_style
from trajeval_ros.report.figures import draw, evaluation_drawings
from trajeval_ros.report.relative_figure import relative_error
from trajeval_ros.report.trajectory_figure import top_view

DRAWINGS = (top_view, absolute_error, relative_error)


@pytest.fixture(scope="module")
def evaluations() -> list[Evaluation]:
    """Five estimates of one flight; the fourth lost track half way."""
    flight = simulate(0, 40.0)
    result = []
    for place in range(5):
        estimate = simulate(place, 40.0).estimate if place == 0 else flight.estimate
        walk = np.random.default_rng(place).normal(size=estimate.positions.shape).cumsum(axis=0)
        moved = dataclasses.replace(
            estimate, positions=estimate.positions + 3e-3 * place * walk, name=f"vio_{place}"
        )
        if place == 3:
            moved = moved[: len(moved) // 2]
        result.append(evaluate(flight.groundtruth, moved, Protocol(gauge=Gauge.YAW)))
    return result


def width_of(png: Path) -> float:
    """Inches, by the resolution in the file."""
    from PIL import Image

    with Image.open(png) as image:
        return image.width / round(image.info["dpi"][0])


@pytest.mark.slow
@pytest.mark.parametrize("width", ["ieee-column", "ieee-page", "slides", "5"])
def test_figures_are_as_wide_as_asked_with_type_of_7_to_9_points(
    width: str, evaluations: list[Evaluation], tmp_path: Path
) -> None:
    style = FigureStyle.parse(None, width, None, has_titles=True)
    inches = WIDTHS_IN.get(width) or float(width)
    (path, *_) = save_all(evaluation_drawings(evaluations[:1]), tmp_path, style)
    assert width_of(path) == pytest.approx(inches, abs=0.01)
    with apply_style(style):
        for drawing in DRAWINGS:
            figure = drawing(evaluations, [evaluation.estimate.name for evaluation in evaluations])
            figure.draw_without_rendering()
            texts = [item for item in figure.findobj(Text) if item.get_text()]
            assert {7.0 <= text.get_fontsize() <= 9.0 for text in texts} == {True}
            assert figure.get_tightbbox().x1 <= inches + 0.02


@pytest.mark.slow
def test_no_legend_covers_data(evaluations: list[Evaluation]) -> None:
    with apply_style():
        for drawing in DRAWINGS:
            for some in (evaluations[:1], evaluations):
                figure = drawing(some, [item.estimate.name for item in some])
                figure.draw_without_rendering()
                legends = [*figure.legends, *(axis.get_legend() for axis in figure.axes)]
                inside = [
                    axes
                    for legend in filter(None, legends)
                    for axes in figure.axes
                    if axes.get_visible()
                    and axes.bbox.shrunk(0.98, 0.98).overlaps(
                        legend.get_window_extent().shrunk(0.98, 0.98)
                    )
                ]
                assert not inside


def test_many_estimates_have_a_panel_each(evaluations: list[Evaluation]) -> None:
    names = [evaluation.estimate.name for evaluation in evaluations]
    with apply_style():
        for drawing, panels in ((top_view, 5), (absolute_error, 10)):
            figure = drawing(evaluations, names)
            shown = [axes for axes in figure.axes if axes.get_visible()]
            assert len(shown) == panels
            titles = [axes.get_title() + axes.get_title(loc="left") for axes in shown]
            for name in names:
                assert sum(name in title for title in titles) == 1
        assert len(top_view(evaluations[:3], names[:3]).axes) == 1


def test_start_and_end_are_marked(evaluations: list[Evaluation]) -> None:
    with apply_style():
        (axes,) = top_view(evaluations[:1], ["vio"]).axes
    matched = evaluations[0].association.groundtruth.positions
    marks = {line.get_label(): line.get_xydata()[0] for line in axes.lines}
    np.testing.assert_allclose(marks["start"], matched[0, :2])
    np.testing.assert_allclose(marks["end"], matched[-1, :2])


def test_large_coordinates_are_subtracted_and_said() -> None:
    flight = simulate(0, 20.0)
    far = dataclasses.replace(
        flight.groundtruth, positions=flight.groundtruth.positions + [448_262.0, -5_411_932.0, 0.0]
    )
    with apply_style():
        (axes,) = draw(evaluate(far, far[::10])).axes
    offset = {}
    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y")):
        text = re.fullmatch(rf"{name} ([−+]) (\d+) \[m\]", axis.get_label_text())
        assert text
        offset[name] = (1.0 if text[1] == "−" else -1.0) * float(text[2])
        low, high = axis.get_view_interval()
        middle = 0.5 * (low + high)
        label = axis.get_major_formatter()(middle, 0)
        assert float(label) + offset[name] == pytest.approx(middle, abs=1e-3)
        assert abs(float(label)) < 1000.0
    near = draw(evaluate(flight.groundtruth, flight.groundtruth[::10]))
    assert near.axes[0].get_xlabel() == "x [m]"


@pytest.mark.slow
def test_titles_are_left_out_and_stay_in_the_metadata(
    evaluations: list[Evaluation], tmp_path: Path
) -> None:
    from PIL import Image

    high = {}
    for has_titles in (True, False):
        style = FigureStyle(has_titles=has_titles)
        path = save_all(evaluation_drawings(evaluations[:1]), tmp_path, style)[0]
        with Image.open(path) as image:
            assert "yaw and position" in image.info["Title"]
        high[has_titles] = len(imread(path))
    assert high[False] < high[True]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_vector_files_have_their_fonts_and_are_the_same_each_time(
    kind: str, evaluations: list[Evaluation], tmp_path: Path
) -> None:
    paths = [tmp_path / f"{name}.{kind}" for name in "ab"]
    for path in paths:
        draw(evaluations[0], "absolute", path)
    first, second = (path.read_bytes() for path in paths)
    assert first == second
    if kind == "pdf":
        assert b"/CIDFontType2" in first  # TrueType, type 42, and no type 3
        assert b"/Type3" not in first


def test_pgf_is_what_latex_takes_and_names_are_no_commands(
    evaluations: list[Evaluation], tmp_path: Path
) -> None:
    program = shutil.which("pdflatex")
    if program is None:
        pytest.skip("there is no LaTeX")
    odd = dataclasses.replace(evaluations[0].estimate, name=r"a_b%{c}$\d")
    draw(dataclasses.replace(evaluations[0], estimate=odd), "absolute", tmp_path / "figure.pgf")
    (tmp_path / "a.tex").write_text(
        "\\documentclass{article}\\usepackage{pgf}\\begin{document}\\input{figure.pgf}"
        "\\end{document}\n"
    )
    command = [program, "-interaction=nonstopmode", "-halt-on-error", "a.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_dark_styles_reach_everything(evaluations: list[Evaluation], tmp_path: Path) -> None:
    import matplotlib

    sheet = tmp_path / "dark.mplstyle"
    dark = Path(matplotlib.get_data_path()) / "stylelib" / "dark_background.mplstyle"
    sheet.write_text(dark.read_text().replace("grid.color: white", "grid.color: 333333"))
    paths = save_all(evaluation_drawings(evaluations[:2]), tmp_path, FigureStyle(file=sheet))
    assert len(paths) >= 4
    for path in paths:
        pixels = imread(path)[:, :, :3]
        assert np.median(pixels) == 0.0
        with apply_style(FigureStyle(file=sheet)):
            assert canvas.groundtruth_colour() == "white"
            assert canvas.tint("#ff0000") == "#590000"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("jpg", None), "jpg"),
        (("png,", None), "figure format"),
        (("png", "narrow"), "inches"),
        (("png", "0.1"), "inches"),
        (("png", "nan"), "inches"),
    ],
)
def test_settings_that_mean_nothing_are_told(words: tuple[str, str | None], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        FigureStyle.parse(*words, None, has_titles=True)


@pytest.mark.parametrize("text", ["fon.size: 8\n", "font.size: large-ish\n", "\x00\xff", None])
def test_a_style_sheet_that_says_nothing_sensible_is_told(
    text: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet = tmp_path / "own.mplstyle"
    if text is not None:
        sheet.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="own"):
        FigureStyle(file=sheet).check()
    arguments = [
        "evaluate",
        "-g",
        "no.txt",
        "-e",
        "no.txt",
        "--style",
        str(sheet),
        "--output",
        "x",
    ]
    assert main(arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_all_formats_and_takes_old_ones_away(tmp_path: Path) -> None:
    bag, out = tmp_path / "flight", tmp_path / "out"
    assert main(["simulate", str(bag), "--duration", "20"]) == 0
    given = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry", "--gauge", "yaw"]
    command = ["evaluate", *given, "--output", str(out), "--quiet"]
    assert main([*command, "--figure-format", "pdf,png", "--no-title"]) == 0
    assert {"trajectory_top.pdf", "trajectory_top.png"} <= {path.name for path in out.iterdir()}
    assert main([*command, "--figure-format", "svg"]) == 0
    names = {path.name for path in out.iterdir()}
    assert "trajectory_top.svg" in names
    assert not {"trajectory_top.pdf", "trajectory_top.png"} & names
    assert main(["evaluate", *given, "--figure-format", "svg", "--quiet"]) == 2


def test_the_ramp_is_viridis() -> None:
    import matplotlib

    shares = np.linspace(0.0, 1.0, 101)
    with apply_style():
        actual = matplotlib.colormaps[matplotlib.rcParams["image.cmap"]](shares)
    theirs = matplotlib.colormaps["viridis"](0.2 + 0.8 * shares)
    np.testing.assert_allclose(actual, theirs, atol=4.0 / 255.0)
    assert palette.rgb(palette.RAMP[-1]) == (253, 231, 37)
