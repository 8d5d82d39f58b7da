"""The picture of recorded runs, read back from its file, and the command line."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from paths import ROOT
from state_rows import as_drawn, states, trajectory

from trajeval_ros import Gauge, Protocol, evaluate
from trajeval_ros.cli.app import main
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.source_info import ReceiveTimes
from trajeval_ros.metrics.as_available import AsAvailable, AvailabilityRule, as_available
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.discontinuities.events import ESTIMATE, FROZEN, Loss
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.simulation.drifting_odometry import simulate
from trajeval_ros.viewer import entity_data, scene_entities
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.viewer.paths import gaps
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.state_lanes import TRACKED, LiveLanes

NAME = "vio"
FRAME = f"world/estimate/{NAME}"
HAVE_RERUN = True
try:
    import rerun
except ImportError:
    HAVE_RERUN = False
needs_rerun = pytest.mark.skipif(not HAVE_RERUN, reason="rerun-sdk is missing, the extra `rerun`")


def evaluated(
    gauge: Gauge = Gauge.YAW,
    duration_s: float = 30.0,
    offset: tuple[float, ...] = (0, 0, 0),
    scale: float = 1.0,
) -> Evaluation:
    flight = simulate(0, duration_s)
    return evaluate(
        dataclasses.replace(
            flight.groundtruth, positions=flight.groundtruth.positions + np.array(offset)
        ),
        dataclasses.replace(
            flight.estimate,
            name=NAME,
            positions=scale * flight.estimate.positions + np.array(offset),
        ),
        Protocol(gauge=gauge),
    )


def available_errors(evaluation: Evaluation) -> AsAvailable:
    """Return the as-available errors of poses that are received 0.1 s after their timestamps."""
    estimate, times = evaluation.estimate, ReceiveTimes(evaluation.estimate.stamps + 100_000_000)
    reading = dataclasses.replace(estimate.reading, receive_times=times)
    return as_available(
        evaluation.groundtruth,
        dataclasses.replace(estimate, reading=reading),
        evaluation.alignment.similarity,
        AvailabilityRule("hold"),
        AssociationRule(),
    )


# The file.


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory):
    """A mono run far from the origin, and its picture."""
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    evaluation = evaluated(Gauge.SIM3, offset=(432_100.0, 5_012_345.0, 410.0), scale=0.4)
    path = tmp_path_factory.mktemp("picture") / "run.rrd"
    write_recording(path, [evaluation], available=[available_errors(evaluation)])
    return evaluation, Rrd(path)


@needs_rerun
def test_drawn_path_is_the_aligned_one_far_from_the_origin(drawn) -> None:
    evaluation, picture = drawn
    (origin,) = picture.rows("__properties/origin", "groundtruth_m")[1]
    _, ((rotation, translation, scale),) = picture.transforms(FRAME)
    assert scale == pytest.approx(evaluation.alignment.similarity.scale, rel=1e-6)
    stamps, rows = picture.strips(f"{FRAME}/path/past")
    ends = np.array([row[0][-1] for row in rows], dtype=np.float64)
    there = ends @ (scale * rotation).T + translation + np.array(origin)
    places = np.searchsorted(evaluation.estimate.stamps, stamps)
    assert (evaluation.estimate.stamps[places] == stamps).all()
    expected = evaluation.alignment.similarity.positions(evaluation.estimate.positions)[places]
    # A step of float32 at 5e6 m would be half a metre.
    assert np.abs(there - expected).max() < 1e-4


@needs_rerun
def test_drawn_numbers_are_the_evaluations(drawn) -> None:
    evaluation, picture = drawn
    stamps, values = picture.numbers(f"metrics/position_error/{NAME}")
    assert (stamps == evaluation.association.estimate.stamps).all()
    assert (values == evaluation.absolute.position_m).all()
    _, level = picture.numbers(f"metrics/ate_position/{NAME}")
    assert (level == evaluation.ate["position_m"].rmse).all()
    for segment in evaluation.relative:
        _, values = picture.numbers(f"metrics/relative_error/{NAME}/{segment.length}")
        assert (values == segment.errors.position_m).all()
    errors = available_errors(evaluation).samples
    for quantity, column in (("position", errors.position_m), ("age", errors.age / 1e9)):
        stamps, values = picture.numbers(f"metrics/available/{quantity}/{NAME}")
        assert (stamps == errors.stamps).all()
        assert (values == column).all()
    ((text,),) = picture.rows("summary", "TextDocument:text")[1]
    assert f"{evaluation.ate['position_m'].rmse:.3f} m" in text


@needs_rerun
def test_gap_is_told_and_not_drawn_across(drawn) -> None:
    evaluation, picture = drawn
    message = [text for (text,) in picture.rows("events", "TextLog:text")[1]]
    assert any("no pairs for 2.0 s" in item for item in message)
    longest = max(
        np.linalg.norm(np.diff(row[0], axis=0), axis=1).max()
        for row in picture.strips(f"{FRAME}/path/past")[1]
    )
    steps = np.linalg.norm(np.diff(evaluation.estimate.positions, axis=0), axis=1)
    across = gaps(evaluation.estimate.stamps)
    assert longest <= steps[~across].max() * 1.001 < steps[across].min()


@needs_rerun
def test_gaps_are_a_lane_and_end_the_lines_of_plots(drawn) -> None:
    evaluation, picture = drawn
    _, states = picture.rows(f"tracking/{NAME}", "StateChange:state")
    assert [item for (item,) in states] == ["tracked", "gap", "tracked"]
    _, values = picture.rows(f"metrics/position_error/{NAME}", "Scalars:scalars")
    across = int(gaps(evaluation.association.estimate.stamps).sum())
    assert int(np.isnan(np.concatenate(values)).sum()) == across == 1


@needs_rerun
def test_run_without_gaps_has_no_empty_chunk_and_its_ellipsoids(tmp_path: Path) -> None:
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    groundtruth = simulate(0, 10.0).groundtruth
    variances = np.array([0.01, 0.04, 0.09, 1.0, 1.0, 1.0])
    covariances = np.tile(np.diag(variances), (len(groundtruth), 1, 1))
    estimate = dataclasses.replace(groundtruth, name=NAME, covariances=covariances)[::10]
    evaluation = evaluate(groundtruth, estimate, Protocol(gauge=Gauge.YAW))
    assert not gaps(evaluation.association.estimate.stamps).any()
    write_recording(tmp_path / "run.rrd", [evaluation])
    picture = Rrd(tmp_path / "run.rrd")
    assert picture.least_rows > 0
    _, half_axes = picture.rows(f"{FRAME}/covariance", "Ellipsoids3D:half_sizes")
    assert len(half_axes) > 10
    for half_axis in half_axes:
        np.testing.assert_allclose(np.sort(half_axis[0]), 3.0 * np.sqrt(variances[:3]), rtol=1e-6)


@needs_rerun
def test_properties_are_the_evaluations(drawn) -> None:
    evaluation, picture = drawn

    def of(name: str) -> object:
        ((value,),) = picture.rows("__properties/evaluation", name)[1]
        return value

    assert of("estimate") == NAME
    assert of("gauge") == "sim3"
    assert of("ate_position_m") == evaluation.ate["position_m"].rmse
    assert of("coverage") == evaluation.association.groundtruth_coverage
    assert of("re_percent") == evaluation.drift.percent.mean


@needs_rerun
def test_frames_of_ros_are_attached_once(tmp_path: Path) -> None:
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    one = evaluated(duration_s=10.0, offset=(432_100.0, 5_012_345.0, 410.0))
    groundtruth = dataclasses.replace(one.groundtruth, frame="map", child_frame="base_link")
    runs = [
        dataclasses.replace(
            one,
            groundtruth=groundtruth,
            estimate=dataclasses.replace(
                one.estimate, name=name, frame=frame, child_frame="base_link"
            ),
        )
        for name, frame in (("a", "odom"), ("b", "map"))
    ]
    write_recording(tmp_path / "run.rrd", runs)
    picture = Rrd(tmp_path / "run.rrd")
    parents = {
        entity.removeprefix("frames/"): picture.rows(entity, "Transform3D:parent_frame")[1]
        for entity in picture.entities
        if entity.startswith("frames/")
    }
    assert parents == {
        "map": [["tf#/world"]],
        "odom": [["tf#/world/estimate/a"]],
        "base_link": [["tf#/world/estimate/a/pose"]],
    }
    (((move,),), (origin,)) = (
        picture.rows("frames/map", "Transform3D:translation")[1],
        picture.rows("__properties/origin", "groundtruth_m")[1],
    )
    assert move == pytest.approx(-np.array(origin))


@needs_rerun
@pytest.mark.parametrize(
    ("full_m", "size_m", "factor"), [(0.5, 20.0, 1.0), (0.01, 30.0, 100.0), (0.1, 30.0, 10.0)]
)
def test_errors_that_paths_hide_are_enlarged(full_m: float, size_m: float, factor: float) -> None:
    from trajeval_ros.viewer.appearance import ErrorScale

    scale = ErrorScale.of(full_m, size_m)
    assert scale.factor == factor
    assert (f"enlarged {factor:g} times" in scale.in_words) == (factor > 1.0)


@pytest.mark.parametrize(
    ("largest", "lasts"), [(0.45, True), (0.2, True), (0.6, False), (0.05, False)]
)
def test_colour_scale_lasts_while_it_suits(largest: float, lasts: bool) -> None:
    from trajeval_ros.viewer.colours import lasting_scale

    assert (lasting_scale(np.linspace(0.0, largest, 100), 0.5) == 0.5) == lasts


@needs_rerun
@pytest.mark.slow
def test_two_hours_stay_few_rows(tmp_path: Path) -> None:
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    evaluation = evaluated(duration_s=7200.0)
    assert len(evaluation.estimate) > 143_000
    write_recording(tmp_path / "run.rrd", [evaluation])
    picture = Rrd(tmp_path / "run.rrd")
    rows = sum(
        len(picture.strips(entity)[0]) for entity in picture.entities if entity.startswith("world")
    )
    # 20 us of each frame per row: 30 ms.
    assert rows <= 1500


@needs_rerun
def test_several_estimates_are_told_apart(tmp_path: Path) -> None:
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    one = evaluated(duration_s=10.0)
    both = [
        dataclasses.replace(one, estimate=dataclasses.replace(one.estimate, name=name))
        for name in ("/a b/c", "x#2")
    ]
    write_recording(tmp_path / "run.rrd", both)
    entities = Rrd(tmp_path / "run.rrd").entities
    frames = {
        entity.split("/path/")[0]
        for entity in entities
        if "world/estimate" in entity and "/path/" in entity
    }
    assert len(frames) == 2


@needs_rerun
@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("covariance", ["message", "joint"])
def test_errors_are_drawn_within_their_bands(covariance: str, tmp_path: Path) -> None:
    from rrd import Rrd

    bag = tmp_path / "flight"
    assert main(["simulate", str(bag), "--profile", "euroc", "--duration", "10"]) == 0
    arguments = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry", "--gauge", "yaw"]
    chosen = "message" if covariance == "message" else f"{bag}.npz"
    arguments += ["--align-states", "1", "--covariance", chosen, "--output", str(tmp_path / "out")]
    arguments += ["--rrd", str(tmp_path / "out" / "run.rrd")]
    assert main(["evaluate", *arguments, "--quiet"]) == 0
    with np.load(tmp_path / "out" / "errors.npz") as file:
        errors, sigmas, nees = (
            file[f"vio_odometry.consistency.{name}"] for name in ("errors", "sigmas", "nees")
        )
    picture = Rrd(tmp_path / "out" / "run.rrd")
    units = np.repeat([1.0, 180.0 / np.pi], 3)
    for axis, quantity in enumerate(scene_entities.ERRORS_WITHIN):
        _, rows = picture.rows(f"metrics/{quantity}/vio_odometry", "Scalars:scalars")
        error, upper, lower = np.array(rows).T
        assert error == pytest.approx(units[axis] * errors[:, axis], rel=1e-12)
        assert upper == pytest.approx(3.0 * units[axis] * sigmas[:, axis], rel=1e-12)
        assert (lower == -upper).all()
    _, drawn = picture.numbers("metrics/nees/vio_odometry")
    assert drawn == pytest.approx(nees[np.isfinite(nees)], rel=1e-12)
    # The largest ellipsoid: three sigma of a position, as many times as the text says.
    ((text,),) = picture.rows("summary", "TextDocument:text")[1]
    factor = float(text.split("3 sigma, enlarged ")[1].split(" times")[0])
    _, half_axes = picture.rows("world/uncertainty/vio_odometry", "Ellipsoids3D:half_sizes")
    largest = max(float(half_axis.max()) for half_axis in half_axes)
    assert largest >= 0.99 * factor * 3.0 * sigmas[-1, :3].max()


@needs_rerun
def test_another_recording_of_a_run_has_all_that_came_before_it(tmp_path: Path) -> None:
    """As a viewer that connects again: colours, their scale, and how the revised path looks."""
    from rrd import Rrd

    flight = simulate(0, 20.0)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.YAW)))
    columns = [
        states(item.positions, item.quaternions) for item in (flight.groundtruth, flight.estimate)
    ]
    evaluator.add_groundtruth(trajectory(flight.groundtruth.stamps, columns[0]))
    evaluator.add_estimate(trajectory(flight.estimate.stamps, columns[1]))
    pairs = evaluator.made()
    assert pairs is not None
    evaluator.evaluate(pairs)
    snapshot, stamp = evaluator.snapshot(), int(evaluator.store.stamps()[-1])
    scene = LiveScene("flight", [NAME], Gauge.YAW)
    errors = available_errors(evaluate(flight.groundtruth, flight.estimate)).samples
    assert errors is not None
    for number in range(2):
        recording = rerun.RecordingStream("trajeval", recording_id=f"run_{number}")
        recording.save(tmp_path / f"{number}.rrd")
        scene.begin(recording)
        if not number:
            scene.groundtruth(flight.groundtruth.stamps, columns[0])
            scene.pairs(NAME, *as_drawn(pairs))
        newest = dataclasses.replace(errors, stamps=errors.stamps + number)
        scene.snapshot(NAME, stamp + number, snapshot, None if number else 0.25, newest)
        scene.finish()
        scene.leave()
        recording.flush()
        del recording
    looks = f"metrics/{scene_entities.REVISED_ATE_POSITION}/{NAME}"
    for number in range(2):
        picture = Rrd(tmp_path / f"{number}.rrd")
        _, scales = picture.rows("legend/scale", "Points2D:labels")
        assert {labels[-1][-2:] for labels in scales} == {" m"}
        assert picture.rows("legend/scale", "Points2D:show_labels")[1] == [[True]] * len(scales)
        assert len(picture.rows(f"{FRAME}/by_error", "LineStrips3D:strips")[1]) >= 1
        assert picture.rows(looks, "SeriesLines:names")[1] == [["vio, ATE of the revised path"]]
        for quantity, column, look in (
            ("position", errors.position_m, "vio, as available"),
            ("age", errors.age / 1e9, "vio"),
        ):
            entity = f"metrics/available/{quantity}/{NAME}"
            assert picture.numbers(entity)[1].tolist() == [column[-1]]
            assert picture.rows(entity, "SeriesLines:names")[1] == [[look]]


@needs_rerun
@pytest.mark.parametrize("estimates", [1, 2])
def test_live_colours_have_one_scale_and_no_line_below_them(
    estimates: int, tmp_path: Path
) -> None:
    from rrd import Rrd

    names = [f"vio_{number}" for number in range(estimates)]
    flight, scene = simulate(0, 30.0), LiveScene("flight", names, Gauge.YAW)
    recording = rerun.RecordingStream("trajeval", recording_id="run")
    recording.save(tmp_path / "run.rrd")
    scene.begin(recording)
    groundtruth = states(flight.groundtruth.positions, flight.groundtruth.quaternions)
    scene.groundtruth(flight.groundtruth.stamps, groundtruth)
    for number, name in enumerate(names):
        moved = flight.estimate.positions * (1.0 + 0.05 * number)
        evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.YAW)))
        evaluator.add_groundtruth(trajectory(flight.groundtruth.stamps, groundtruth))
        estimate = states(moved, flight.estimate.quaternions)
        for part in np.array_split(np.arange(len(estimate)), 8):
            evaluator.add_estimate(trajectory(flight.estimate.stamps[part], estimate[part]))
            pairs = evaluator.made()
            evaluator.evaluate(pairs)
            if pairs is not None:
                scene.pairs(name, *as_drawn(pairs))
            newest = int(evaluator.store.stamps()[-1])
            scene.snapshot(name, newest, evaluator.snapshot(), None)
    scene.finish()
    scene.leave()
    recording.flush()
    picture = Rrd(tmp_path / "run.rrd")
    stamps, scales = picture.rows("legend/scale", "Points2D:labels")
    now, full_m = int(stamps[-1]), float(scales[-1][-1].split()[0])
    worst = 0.0
    for name in names:
        frame = f"world/estimate/{name}"
        coloured = picture.strips(f"{frame}/by_error")[1][-1]
        lines = picture.path(frame, now)
        assert (len(lines) == len(coloured)) == (estimates == 1)
        _, errors = picture.strips(f"world/correspondences/{name}")
        ends = np.array(errors[-1])
        worst = max(worst, float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max()))
    factor = float(scales[-1][1].removeprefix("lines x ")) if len(scales[-1]) == 3 else 1.0
    assert 0.2 * full_m < worst / factor < 1.5 * full_m


@needs_rerun
def test_live_lanes_show_status_and_alarms(tmp_path: Path) -> None:
    from rrd import Rrd

    scene = LiveScene("flight", [NAME], Gauge.YAW)
    recording = rerun.RecordingStream("trajeval", recording_id="run")
    recording.save(tmp_path / "run.rrd")
    scene.begin(recording)
    alarm = Remark(Level.ERROR, "alarm", "position error of 2 m", "position_m")
    late = Remark(Level.WARNING, "delay", "messages are late")
    for second, remarks in enumerate(([], [alarm, late], [alarm], [late], [])):
        scene.status(NAME, second * 1_000_000_000, remarks)
    scene.leave()
    recording.flush()
    picture = Rrd(tmp_path / "run.rrd")

    def lane(entity: str) -> list[str]:
        return [item for (item,) in picture.rows(entity, "StateChange:state")[1]]

    assert lane(f"status/{NAME}") == ["OK", "error", "warning", "OK"]
    assert lane(f"alarm/{NAME}/position_m") == ["error", "OK"]
    message = [text for (text,) in picture.rows("events", "TextLog:text")[1]]
    assert message == [f"{NAME}: {item.text}" for item in (alarm, late)]


def test_a_lane_shows_a_frozen_estimate_from_its_begin_on() -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    drawn: list[tuple[int, str]] = []
    recording = SimpleNamespace(send=lambda *_: None, log=lambda time, *_: drawn.append(time))
    lanes, second = LiveLanes(cast("Any", recording)), 1_000_000_000
    lost = Loss(FROZEN, ESTIMATE, 5 * second, 5 * second)
    lanes.tracking("tracking/a", second, lost)
    assert drawn == []  # the lane begins with the first pair
    lanes.change("tracking/a", second, TRACKED)
    states = []
    for time, loss in ((4, None), (8, lost), (9, lost), (11, None), (12, None)):
        lanes.tracking("tracking/a", time * second, loss)
        states.append(lanes._now["tracking/a"])
    assert states == [
        (second, TRACKED),
        *2 * [(5 * second, FROZEN)],
        *2 * [(11 * second, TRACKED)],
    ]
    assert drawn == [second, 5 * second, 11 * second]


# The command line.


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    bag = tmp_path_factory.mktemp("bag") / "flight"
    assert main(["simulate", str(bag), "--duration", "10"]) == 0
    return ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry", "--quiet"]


@pytest.mark.slow
def test_without_rerun_one_sentence_names_the_extra(sources: list[str], tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['rerun'] = None; from trajeval_ros.cli.app import main; "
        "sys.exit(main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "evaluate", *sources, "--rrd", str(tmp_path / "a.rrd")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "rerun" in done.stderr
    assert "pip install" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@needs_rerun
@pytest.mark.usefixtures("no_figures")
def test_evaluate_writes_the_picture(sources: list[str], tmp_path: Path) -> None:
    from rrd import Rrd

    output = ["--output", str(tmp_path / "out")]
    for path in (tmp_path / "a.rrd", tmp_path / "out" / "run.rrd"):
        assert main(["evaluate", *sources, "--rrd", str(path), *output]) == 0
        assert "world/groundtruth/path/past" in Rrd(path).entities
    assert {item.name for item in tmp_path.iterdir()} == {"a.rrd", "out"}
    # One that was not asked for is not written, and none of an earlier evaluation stays.
    assert main(["evaluate", *sources, *output]) == 0
    assert not (tmp_path / "out" / "run.rrd").exists()


@needs_rerun
def test_file_that_cannot_be_written(
    sources: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *sources, "--rrd", str(tmp_path / "no" / "a.rrd")]) == 2
    assert "a.rrd can't be written: no such file or directory" in capfd.readouterr().err


@needs_rerun
@pytest.mark.parametrize(
    ("content", "printed"),
    [(b"RRF2", "no display found; use --web"), (b"pairs", "is not a Rerun file")],
)
def test_view_says_what_is_wrong(
    content: bytes,
    printed: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "run.rrd").write_bytes(content)
    assert main(["view", str(tmp_path)]) == 2
    assert printed in capsys.readouterr().err


@needs_rerun
def test_screenshot_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.rrd").write_bytes(b"pairs")
    expected = ["--screenshot", str(tmp_path / "a.png")]
    assert main(["view", str(tmp_path), *expected]) == 2
    assert "is not a Rerun file" in capsys.readouterr().err
    assert main(["view", str(tmp_path), *expected, "--web"]) == 2
    assert "exclude each other" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"run.rrd"}


@pytest.mark.parametrize(
    ("name", "printed"), [("nothing", "does not exist"), ("", "no run.rrd in")]
)
def test_view_says_what_it_needs(
    name: str, printed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(tmp_path / name)]) == 2
    assert printed in capsys.readouterr().err


@pytest.mark.parametrize(("begin_ns", "kind"), [(0, "duration"), (1_700_000_000 * 10**9, "date")])
def test_a_clock_that_starts_at_zero_has_no_date(begin_ns: int, kind: str, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    rerun, _ = sdk()
    recording = rerun.RecordingStream("clock")
    recording.save(tmp_path / "clock.rrd")
    stamps = begin_ns + np.arange(3, dtype=np.int64) * 10**9
    entity_data.numbers(np.zeros(3)).send(recording, "sent", stamps)
    entity_data.log(recording, "logged", begin_ns, entity_data.numbers([1.0]).row())
    recording.disconnect()
    types = Rrd(tmp_path / "clock.rrd").clocks
    assert len(types) == 1
    assert ("duration" in types.pop()) is (kind == "duration")
