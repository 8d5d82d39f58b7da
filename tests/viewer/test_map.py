"""The map of a Rerun file: fixes and estimates by latitude and longitude."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fix_runs import DATUM, fixes_of, quality
from state_rows import as_drawn, states, trajectory

from trajeval_ros import Gauge, Protocol, evaluate, simulate
from trajeval_ros.geometry.geodesy import east_north_up
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings

pytest.importorskip("rerun", reason="rerun-sdk is missing")

import rerun

from trajeval_ros.viewer import fix_map
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.viewer.recorded_scene import write_recording

FLIGHT = simulate(seed=8, duration_s=40.0)


def test_a_map_has_fixes_and_tracks_where_they_are(tmp_path: Path) -> None:
    pytest.importorskip("rerun.chunk")
    from rrd import Rrd

    groundtruth = FLIGHT.groundtruth[::80]
    rows = quality(len(groundtruth))
    rows[10:20, 0] = 0
    fixes = fixes_of(groundtruth.stamps, groundtruth.positions, rows)
    evaluation = evaluate(fixes, FLIGHT.estimate, Protocol(gauge="yaw"))
    write_recording(tmp_path / "run.rrd", [evaluation])
    picture = Rrd(tmp_path / "run.rrd")
    _, [points] = picture.rows("map/fixes", "GeoPoints:positions")
    assert fixes.reading.fixes is not None
    np.testing.assert_allclose(points, fixes.reading.fixes.places[:, :2], rtol=1e-15)
    _, [colours] = picture.rows("map/fixes", "GeoPoints:colors")
    assert len(set(colours)) == 2
    _, [lines] = picture.rows("map/estimate/odometry", "GeoLineStrings:line_strings")
    track = np.concatenate([np.array(line) for line in lines])
    places = np.column_stack([track, np.full(len(track), DATUM.height_m)])
    datum = fixes.reading.fixes.datum
    assert datum is not None
    aligned = evaluation.alignment.similarity.positions(FLIGHT.estimate.positions)
    east_north = east_north_up(places, datum)[:, :2]
    # A map knows no heights, above which a degree is a little longer.
    heights_m = float(np.abs(aligned[:, 2]).max() + abs(datum.height_m - DATUM.height_m))
    size_m = float(np.abs(aligned[:, :2]).max())
    off_m = heights_m * size_m / 6.3e6
    np.testing.assert_allclose(east_north, aligned[:, :2], atol=off_m)
    assert math.isfinite(off_m)
    assert off_m < 0.01


def live(path: Path, fixes: Trajectory) -> list[Any]:
    """Draw a live run by fixes into a file; returns its layouts."""
    settings = OnlineSettings(Protocol(gauge="yaw"), window="0")
    evaluator = OnlineEvaluator(settings)
    recording = rerun.RecordingStream("trajeval", recording_id="live")
    recording.save(path)
    scene, estimate = LiveScene("drive", ["odometry"], Gauge.YAW), FLIGHT.estimate
    layouts = [scene.blueprint]
    scene.begin(recording)
    rows = states(estimate.positions, estimate.quaternions)
    for number, stamp in enumerate(fixes.stamps.tolist()):
        own = slice(number, number + 1)
        one = fixes[own]
        scene.groundtruth(one.stamps, states(one.positions))
        assert one.reading.fixes is not None
        scene.fixes(one.stamps, one.reading.fixes)
        layouts += [scene.blueprint] if scene.blueprint is not layouts[-1] else []
        evaluator.add_groundtruth(trajectory(one.stamps, states(one.positions)))
        new = (estimate.stamps > stamp - 400_000_000) & (estimate.stamps <= stamp)
        evaluator.add_estimate(trajectory(estimate.stamps[new], rows[new]))
        pairs = evaluator.made()
        evaluator.evaluate(pairs)
        if pairs is not None:
            scene.pairs("odometry", *as_drawn(pairs))
        if evaluator.pairs:
            newest = int(evaluator.store.stamps()[-1])
            scene.snapshot("odometry", newest, evaluator.snapshot(), None)
    scene.finish()
    scene.leave()
    recording.flush()
    return layouts


@pytest.mark.slow
def test_the_live_map_is_the_recorded_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun.chunk")
    from rrd import Rrd

    monkeypatch.setattr(fix_map, "_MOST_WHILE_GROWING", 20)
    groundtruth = FLIGHT.groundtruth[::80]
    rows = quality(len(groundtruth))
    rows[10:20, 0] = 0
    fixes = fixes_of(groundtruth.stamps, groundtruth.positions, rows)
    layouts = live(tmp_path / "live.rrd", fixes)
    assert len(layouts) == 2  # with the map since the first fix
    evaluation = evaluate(fixes, FLIGHT.estimate, Protocol(gauge="yaw"))
    write_recording(tmp_path / "run.rrd", [evaluation])
    drawn, recorded = Rrd(tmp_path / "live.rrd"), Rrd(tmp_path / "run.rrd")
    assert {entity for entity in drawn.entities if entity.startswith("map")} == {
        entity for entity in recorded.entities if entity.startswith("map")
    }
    for component in ("GeoPoints:positions", "GeoPoints:colors", "GeoPoints:radii"):
        [expected] = recorded.rows("map/fixes", component)[1]
        np.testing.assert_array_equal(drawn.rows("map/fixes", component)[1][-1], expected)
    # While the run goes on, a drawing has few points, and follows in two seconds.
    stamps, points = drawn.rows("map/fixes", "GeoPoints:positions")
    assert max(map(len, points[:-1])) == 20
    assert np.diff(stamps[:-1]).min() >= 2_000_000_000
    assert np.diff(stamps).max() <= 2_000_000_000 + np.diff(fixes.stamps).max()
    _, tracks = drawn.rows("map/estimate/odometry", "GeoLineStrings:line_strings")
    assert max(sum(map(len, track)) for track in tracks[:-1]) <= 20
    [lines] = recorded.rows("map/estimate/odometry", "GeoLineStrings:line_strings")[1]
    known = np.concatenate([np.array(line) for line in lines])
    seen = np.concatenate([np.array(track) for track in tracks[-1]])
    # Of the estimate, the live map has the states at the fixes.
    apart_m = 111e3 * np.abs(seen[:, None] - known).max(axis=2).min(axis=1)
    assert len(seen) > 90
    assert apart_m.max() < 0.1


def test_other_groundtruth_has_no_map(tmp_path: Path) -> None:
    pytest.importorskip("rerun.chunk")
    from rrd import Rrd

    evaluation = evaluate(FLIGHT.groundtruth, FLIGHT.estimate, Protocol(gauge="yaw"))
    write_recording(tmp_path / "run.rrd", [evaluation])
    assert not [
        entity for entity in Rrd(tmp_path / "run.rrd").entities if entity.startswith("map")
    ]
