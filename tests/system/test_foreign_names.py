"""Names from elsewhere in what draws and what a live run says; tables are in test_formatting."""

from __future__ import annotations

import dataclasses
import io
import sys
from html import escape
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from control_characters import controls

from trajeval_ros import Gauge, Protocol, evaluate
from trajeval_ros.formatting.remarks import warning
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.ros.terminal import StatusLine
from trajeval_ros.simulation.drifting_odometry import simulate

NAME = "\x1b]0;x\x07\x9b\u202e\n$x^2$ \udc80"
SEEN = r"\x1b]0;x\x07\x9b\u202e $x^2$ \udc80"


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    flight = simulate(0, 10.0)
    estimate = dataclasses.replace(flight.estimate, name=NAME)
    return evaluate(flight.groundtruth, estimate, Protocol(gauge=Gauge.YAW, lengths=()))


def test_the_status_line_is_one_line_that_controls_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr("trajeval_ros.ros.terminal._width", lambda: 200)
    StatusLine().show([f"{NAME}: ATE 1 m", "b"])
    begin = "\r\x1b[K"
    assert terminal.getvalue() == f"{begin}{SEEN}: ATE 1 m  |  b"
    # Cut as it is shown, so that nothing wraps.
    monkeypatch.setattr("trajeval_ros.ros.terminal._width", lambda: 20)
    StatusLine().show([NAME])
    assert len(terminal.getvalue().rpartition(begin)[2]) == 19


def test_figures_show_names_and_no_formulas(evaluation: Evaluation) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    from matplotlib.text import Text

    from trajeval_ros.report import absolute_figure, canvas
    from trajeval_ros.report.figure_style import apply_style

    [name] = canvas.short_names([NAME])
    assert name == SEEN
    with apply_style():
        figure = absolute_figure.absolute_error([evaluation], [f"{name} {name}"])
        figure.canvas.draw()
        texts = [text for text in figure.findobj(Text) if isinstance(text, Text)]
    assert not any(text.get_parse_math() for text in texts)
    assert not controls("".join(text.get_text() for text in texts).replace("\n", ""))


@pytest.mark.slow
def test_figures_of_a_comparison_show_names() -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    from trajeval_ros.batch.planned_figures import PlannedFigure, draw
    from trajeval_ros.report.comparison_figures import Box, BoxPlot, PathsPlot

    box, path = Box.of([1.0, 2.0]), np.zeros((2, 3))
    boxes = BoxPlot([NAME], [("_vio", [box]), (NAME, [box])], "", "m")
    paths = PathsPlot(UpAxis(), path, {1: (NAME, path)})
    for plot in (boxes, paths):
        drawn = draw(PlannedFigure("name", NAME, "", plot), ("svg",))
        file = drawn.files["name.svg"].decode()
        assert ElementTree.fromstring(file) is not None
        assert ElementTree.fromstring(drawn.svg) is not None
        for text in (drawn.svg, file):
            assert not controls(text.replace("\n", ""))
            assert escape(SEEN, quote=False) in text or escape(SEEN) in text
    assert "_vio" in draw(PlannedFigure("", "", "", boxes), ()).svg


def test_the_picture_shows_names(evaluation: Evaluation, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    warned = dataclasses.replace(evaluation, remarks=(warning("name", NAME),))
    file = tmp_path / "run.rrd"
    write_recording(file, [warned])
    written = Rrd(file)
    _, lines = written.rows("events", "TextLog:text")
    assert f"{SEEN}: {SEEN}" in [str(line[0]) for line in lines]
    assert not controls("".join(str(line[0]) for line in lines))
    assert not controls("".join(written.entities))
    _, [words] = written.rows("summary", "TextDocument:text")
    assert not controls(str(words[0]).replace("\n", ""))
