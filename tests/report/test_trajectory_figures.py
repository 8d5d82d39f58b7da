"""The figures of `trajeval trajectory`: what is drawn, in which colours."""

from __future__ import annotations

import dataclasses
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.travelled import speeds
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip("matplotlib", reason="figures need the extra `plot`")

from matplotlib.image import imread
from paths import ROOT

from trajeval_ros.report.figure_style import FigureStyle, apply_style
from trajeval_ros.report.motion_figures import PLOTS, Colours, motion_drawings
from trajeval_ros.report.plane_panels import PlanePanels


def circle(count: int = 200, radius_m: float = 2.0, turns_s: float = 0.1) -> Trajectory:
    """A body on a level circle, facing ahead."""
    angle = 2.0 * np.pi * turns_s * np.arange(count) * 0.05
    positions = radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    rotation = np.stack([np.zeros(count), np.zeros(count), angle], axis=1)
    return Trajectory.from_columns(
        stamps=(NANOSECONDS * 0.05 * np.arange(count)).round().astype(np.int64),
        positions=positions,
        quaternions=lie.from_rotation_vector(rotation),
        name="circle",
    )


@pytest.mark.slow
def test_a_home_that_cannot_be_written_gives_no_warnings(tmp_path: Path) -> None:
    """Nor does a list of fonts that takes long to make, of which the same logger warns."""
    assert main(["simulate", str(tmp_path / "flight"), "--duration", "10"]) == 0
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), "/proc/nowhere")
    command = ["trajectory", f"{tmp_path / 'flight'}:/vio/odometry", "--plot", "xy", "--quiet"]
    done = subprocess.run(
        [sys.executable, "-m", "trajeval_ros", *command, "--output", str(tmp_path / "plots")],
        env={**os.environ, "PYTHONPATH": str(ROOT), **nowhere},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "plots" / "path_xy.png").exists()


def test_speeds_of_a_circle() -> None:
    path = circle()
    linear, turning = speeds(path.stamps, path.positions, path.quaternions)
    chord = 2.0 * 2.0 * math.sin(math.pi * 0.1 * 0.05) / 0.05
    np.testing.assert_allclose(linear, chord, rtol=1e-9)
    assert turning is not None
    np.testing.assert_allclose(turning, 2.0 * math.pi * 0.1, rtol=1e-9)
    _, nothing = speeds(path.stamps, path.positions, None)
    assert nothing is None


def test_every_plot_shows_the_trajectory_and_its_reference() -> None:
    flown = circle()
    reference = dataclasses.replace(circle(400), name="truth")
    with apply_style():
        drawings = motion_drawings(PLOTS, [flown], reference)
        figures = {name: draw() for name, draw in drawings.items()}
    assert list(figures) == [
        "path_xy", "path_xz", "path_yz", "path_3d",
        "xyz_over_time", "rpy_over_time", "speed_over_time",
    ]  # fmt: skip
    for figure in figures.values():
        (legend,) = figure.legends
        assert {"reference", "circle"} <= {text.get_text() for text in legend.get_texts()}
    _, _, yaw = figures["rpy_over_time"].axes
    (line,) = [item for item in yaw.lines if item.get_label() == "circle"]
    np.testing.assert_allclose(
        line.get_ydata(), np.degrees(2.0 * np.pi * 0.1 * line.get_xdata()), atol=1e-6
    )
    _, turning = figures["speed_over_time"].axes
    np.testing.assert_allclose(turning.lines[-1].get_ydata(), 36.0, rtol=1e-9)


def test_the_path_is_coloured_by_its_error_with_a_bar() -> None:
    reference = circle()
    ramp = np.linspace(0.0, 0.5, len(reference))
    off = reference.positions + ramp[:, None] * [0.0, 0.0, 1.0]
    off[7] += [0.0, 0.0, 90.0]  # an outlier does not set the scale
    estimate = dataclasses.replace(reference, positions=off)
    for largest, expected in ((None, np.percentile(ramp, 99.0)), (0.2, 0.2)):
        colours = Colours("error", largest)
        with apply_style():
            (draw,) = motion_drawings(["xy"], [estimate], reference, colours=colours).values()
            figure = draw()
        panel, bar = figure.axes
        assert bar.get_ylabel() == "position error [m]"
        coloured = panel.collections[-1]
        np.testing.assert_allclose(coloured.get_array()[8:-1], ramp[8:-2], atol=1e-9)
        assert coloured.get_clim() == pytest.approx((0.0, expected), rel=0.02)
        assert coloured.colorbar.extend == "max"
    with pytest.raises(InputError, match="--reference"):
        motion_drawings(["xy"], [reference], None, colours=Colours("error"))["path_xy"]()


@pytest.mark.slow
def test_the_command_draws_and_replaces_its_figures_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, out = tmp_path / "flight", tmp_path / "out"
    assert main(["simulate", str(bag), "--duration", "10"]) == 0
    command = ["trajectory", f"{bag}:/vio/odometry", "--reference", f"{bag}:/groundtruth/pose"]
    command += ["--gauge", "yaw", "--output", str(out)]
    more = ["--plot", "xy,speed", "--colour-by", "error"]
    assert main([*command, *more, "--figure-format", "png,svg"]) == 0
    names = ["path_xy.png", "path_xy.svg", "speed_over_time.png", "speed_over_time.svg"]
    assert sorted(path.name for path in out.iterdir()) == names
    assert imread(out / "path_xy.png").std() > 0.05
    (out / "path_xy.png").write_bytes(b"older")
    assert main([*command, *more]) == 0
    assert imread(out / "path_xy.png").std() > 0.05
    # Trajectories are data: they are never replaced.
    assert main([*command, "--save-as", "tum"]) == 0
    capsys.readouterr()
    assert main([*command, "--save-as", "tum"]) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--plot", "zx"], "use one of xy"),
        (["--colour-by", "error"], "--plot"),
    ],
)
def test_what_cannot_be_drawn_is_told_before_anything_is_read(
    more: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trajectory", "no.txt", *more]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "no.txt" not in error


def test_trajectories_without_stamps_are_drawn_over_the_index() -> None:
    made = circle()
    late = dataclasses.replace(made, stamps=made.stamps + 1_700_000_000 * NANOSECONDS)
    counted = dataclasses.replace(made, reading=SourceInfo("KITTI", stamped=False))
    labels = {"xyz": "z [m]", "rpy": "yaw [deg]", "speed": "turn [deg/pose]"}
    with apply_style():
        for kind, drawing in zip(
            ("xy", *labels),
            motion_drawings(("xy", *labels), [counted], late).values(),
            strict=True,
        ):
            figure = drawing()
            if kind == "xy":
                continue
            axes = figure.axes[-1]
            assert axes.get_xlabel() == "pose"
            assert axes.get_ylabel().replace("$", "") == labels[kind]
            for line in axes.lines[:2]:
                assert line.get_xdata()[-1] == len(made) - 1
                assert 0 <= line.get_xdata()[0] <= 1
        steps = figure.axes[0].lines[1].get_ydata()
    np.testing.assert_allclose(steps, np.linalg.norm(np.diff(made.positions, axis=0), axis=1)[0])
    with pytest.raises(
        InputError, match="circle has no timestamps, which --colour-by speed needs; set"
    ):
        motion_drawings(["xy"], [counted], None, colours=Colours("speed"))
    positions = dataclasses.replace(simulate(0, 5.0).groundtruth, quaternions=None)
    with pytest.raises(InputError, match="no orientations"):
        motion_drawings(["rpy"], [positions], None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "rows"), [("ieee-column", [2, 2, 1]), ("ieee-page", [3, 2])], ids=["narrow", "wide"]
)
def test_five_paths_fill_rows_evenly_and_the_lowest_of_each_column_is_labelled(
    width: str, rows: list[int]
) -> None:
    angle = np.linspace(0.0, 6.0, 50)
    truth = np.stack([np.cos(angle), 0.8 * np.sin(angle), 0.0 * angle], axis=1)
    with apply_style(FigureStyle.parse(None, width, None, has_titles=True)):
        names = {index: f"vio_{index}" for index in range(5)}
        panels = PlanePanels([truth[:, :2]], names, "Trajectories on hall")
        for index in range(5):
            panels.draw_path(index, truth[:, :2])
        figure = panels.finish(truth[:, :2], truth[:, :2], ("x", "y"))
        figure.draw_without_rendering()
        shown = [axes for axes in figure.axes if axes.get_visible()]
        boxes = [axes.get_window_extent() for axes in shown]
        heights = sorted({round(box.y0) for box in boxes}, reverse=True)
        assert [sum(round(box.y0) == height for box in boxes) for height in heights] == rows
        for axes, box in zip(shown, boxes, strict=True):
            below = any(round(other.x0) == round(box.x0) and other.y0 < box.y0 for other in boxes)
            assert axes.get_xlabel() == ("" if below else "x [m]")
            assert any(tick.label1.get_visible() for tick in axes.xaxis.get_major_ticks()) != below
        title = figure.texts[0].get_window_extent()
        assert all(axes.title.get_window_extent().y1 <= title.y0 for axes in shown)


def test_angles_are_within_half_a_turn_of_the_reference(
    recording: Callable[[str], Trajectory],
) -> None:
    # Pitches of a forward camera come close to 90 degrees, where unwrapped angles separate.
    truth, estimate = (recording(f"kitti/KITTI_00_{name}.txt") for name in ("gt", "ORB"))
    assert truth.quaternions is not None
    with apply_style():
        figure = motion_drawings(["rpy"], [estimate], truth)["rpy_over_time"]()
    angles = np.degrees(np.unwrap(lie.euler_angles(truth.quaternions)[:, ::-1], axis=0))
    for axes, expected in zip(figure.axes, angles.T, strict=True):
        pose = axes.lines[1].get_xdata().round().astype(int)
        assert np.abs(axes.lines[1].get_ydata() - expected[pose]).max() < 180.0 + 1e-6
