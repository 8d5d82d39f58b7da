"""The map of a Rerun file: fixes and estimates by latitude and longitude."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from fix_runs import DATUM, fixes_of, quality

from trajeval_ros import Protocol, evaluate, simulate
from trajeval_ros.geometry.geodesy import east_north_up

pytest.importorskip("rerun", reason="rerun-sdk is missing")

from trajeval_ros.viewer.recorded_scene import write_recording

FLIGHT = simulate(seed=8, duration_s=40.0)


def test_a_map_has_fixes_and_tracks_where_they_are(tmp_path: Path) -> None:
    pytest.importorskip("rerun.chunk")
    from rrd import Rrd

    truth = FLIGHT.groundtruth[::80]
    rows = quality(len(truth))
    rows[10:20, 0] = 0
    fixes = fixes_of(truth.stamps, truth.positions, rows)
    evaluation = evaluate(fixes, FLIGHT.estimate, Protocol(gauge="yaw"))
    write_recording(tmp_path / "run.rrd", [evaluation])
    picture = Rrd(tmp_path / "run.rrd")
    _, [points] = picture.rows("map/fixes", "GeoPoints:positions")
    assert fixes.fixes is not None
    np.testing.assert_allclose(points, fixes.fixes.places[:, :2], rtol=1e-15)
    _, [colours] = picture.rows("map/fixes", "GeoPoints:colors")
    assert len(set(colours)) == 2
    _, [lines] = picture.rows("map/estimate/odometry", "GeoLineStrings:line_strings")
    track = np.concatenate([np.array(each) for each in lines])
    places = np.column_stack([track, np.full(len(track), DATUM.height_m)])
    datum = fixes.fixes.datum
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


def test_other_groundtruth_has_no_map(tmp_path: Path) -> None:
    pytest.importorskip("rerun.chunk")
    from rrd import Rrd

    evaluation = evaluate(FLIGHT.groundtruth, FLIGHT.estimate, Protocol(gauge="yaw"))
    write_recording(tmp_path / "run.rrd", [evaluation])
    assert not [each for each in Rrd(tmp_path / "run.rrd").entities if each.startswith("map")]
