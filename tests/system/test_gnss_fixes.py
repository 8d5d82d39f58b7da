"""GNSS fixes: which are used, in which frame, from which kinds of files."""

from __future__ import annotations

import dataclasses
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fix_runs import DATUM, fixes_of, places_of, quality
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros import OnlineSettings, Protocol, Request, evaluate, run, simulate
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.fix_selection import FixRule, trajectory_of_rows
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum, east_north_up
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.pose_messages import FIX_TYPE
from trajeval_ros.io.bags.write_bag import ODOMETRY, write_bag
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.sources import read_trajectory

FLIGHT = simulate(seed=3, duration_s=40.0)
LEVER = (0.3, -0.1, 0.5)


def antenna(step: int = 200, lever: tuple[float, float, float] = LEVER) -> Trajectory:
    """Return fixes of an antenna on the flight, one a second."""
    truth = FLIGHT.groundtruth[100::step]
    assert truth.rotations is not None
    return fixes_of(truth.stamps, truth.positions + truth.rotations.apply(lever))


def bag_of(path: Path, fixes: Trajectory) -> str:
    topics = {"/fix": (fixes, FIX_TYPE), "/odom": (FLIGHT.estimate, ODOMETRY)}
    write_bag(path, topics)
    return str(path)


# Which fixes are used.


def test_fixes_without_height_have_a_place_in_the_plane_alone() -> None:
    positions = np.arange(18.0).reshape(-1, 3)
    places = places_of(positions)
    places[[0, 3], 2] = np.nan
    read = trajectory_of_rows("x", np.arange(6), places, quality(6), SourceInfo())
    spatial = FixRule(datum=DATUM).applied(read)
    assert spatial.stamps.tolist() == [1, 2, 4, 5]
    assert spatial.reading.dropped == {"no_height": 2}
    np.testing.assert_allclose(spatial.positions, positions[[1, 2, 4, 5]], atol=1e-8)
    planar = FixRule(datum=DATUM).applied(read, level=True)
    assert planar.stamps.tolist() == list(range(6))
    assert planar.reading.dropped == {}
    np.testing.assert_allclose(planar.positions[:, :2], positions[:, :2], atol=1e-4)
    # The first fix that is used is the origin; the height of no fix is 0.
    first = FixRule().applied(read, level=True)
    assert first.reading.fixes is not None
    assert first.reading.fixes.datum == Datum(places[0, 0], places[0, 1], 0.0)


def test_the_datum_is_the_first_fix_in_time_or_the_one_that_is_given() -> None:
    positions = np.arange(12.0).reshape(-1, 3)
    actual = fixes_of(np.array([30, 10, 20, 40]), positions)
    assert actual.reading.fixes is not None
    assert actual.reading.fixes.datum == Datum(*places_of(positions)[1])
    moved = FixRule(datum=DATUM).applied(actual)
    np.testing.assert_array_equal(moved.positions, east_north_up(places_of(positions), DATUM))
    assert FixRule().applied(actual) is actual


@pytest.mark.parametrize("value", [-1, -2])
def test_a_receiver_that_never_had_a_fix(value: int) -> None:
    rows = quality(9, status=value, kind=0)
    with pytest.raises(InputError, match=r"no usable fix among 9 \(9 no fix\)"):
        fixes_of(np.arange(9), np.arange(27.0).reshape(-1, 3), rows)


def test_a_receiver_that_repeats_itself() -> None:
    with pytest.raises(InputError, match=r"all fixes .* are at the same place"):
        fixes_of(np.arange(5), np.zeros((5, 3)))


def test_latitude_and_longitude_of_zero_are_no_fix() -> None:
    with pytest.raises(InputError, match="4 no fix"):
        trajectory_of_rows("x", np.arange(4), np.zeros((4, 3)), quality(4), SourceInfo())


def test_a_datum_on_another_continent() -> None:
    with pytest.raises(InputError, match=r"km away from the first fix.*check the order"):
        FixRule(datum=Datum(8.5, 47.4, 430.0)).applied(antenna())


def test_fixes_without_heights_are_for_the_plane() -> None:
    fixes = antenna()
    assert fixes.reading.fixes is not None
    places = fixes.reading.fixes.places.copy()
    places[:, 2] = np.nan
    flat = trajectory_of_rows("x", fixes.stamps, places, quality(len(places)), SourceInfo())
    with pytest.raises(InputError, match="fixes have no height; use --gauge planar"):
        run(flat, [FLIGHT.estimate], Request(Protocol(gauge="yaw")))
    planar = Protocol(gauge="planar", lever_m=LEVER)
    actual, whole = (run(item, [FLIGHT.estimate], Request(planar)) for item in (flat, fixes))
    ate = [item.runs[0].evaluation.ate["position_m"] for item in (actual, whole)]
    assert ate[0] is not None
    assert ate[1] is not None
    assert ate[0].rmse == pytest.approx(ate[1].rmse, abs=1e-4)
    assert actual.runs[0].evaluation.ate["vertical_m"] is None


def test_gauge_none_wants_a_datum() -> None:
    with pytest.raises(InputError, match="arbitrary; give the origin"):
        run(antenna(), [FLIGHT.estimate], Request(Protocol(gauge="none")))
    given = Request(Protocol(gauge="none"), fixes=FixRule(datum=DATUM))
    assert run(antenna(), [FLIGHT.estimate], given).runs
    # Where both sides are fixes, they are in one frame.
    both = run(antenna(), [antenna(40)], Request(Protocol(gauge="none")))
    ate = both.runs[0].evaluation.ate["position_m"]
    assert ate is not None
    assert ate.max < 0.05  # straight lines between fixes of 5 Hz


# Where they come from.


def assert_same_fixes(actual: Trajectory, fixes: Trajectory) -> None:
    np.testing.assert_array_equal(actual.stamps, fixes.stamps)
    np.testing.assert_array_equal(actual.positions, fixes.positions)
    assert actual.reading.fixes is not None
    assert fixes.reading.fixes is not None
    np.testing.assert_array_equal(
        actual.reading.fixes.covariances, fixes.reading.fixes.covariances
    )
    np.testing.assert_array_equal(
        actual.reading.fixes.covariance_types, fixes.reading.fixes.covariance_types
    )
    assert (actual.child_frame, actual.frame, actual.kind) == ("gps", "east_north_up", "gnss")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_rosbag2(storage: Any, tmp_path: Path) -> None:
    fixes = antenna()
    write_bag(tmp_path / "bag", {"/fix": (fixes, FIX_TYPE)}, storage)
    actual = read_trajectory(f"{tmp_path / 'bag'}:/fix")
    assert_same_fixes(actual, fixes)
    assert actual.reading.fixes is not None
    assert actual.reading.fixes.status.tolist() == [2] * len(fixes)


def test_ros1(tmp_path: Path) -> None:
    fixes, store = antenna(), get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    assert fixes.reading.fixes is not None
    with Ros1Writer(tmp_path / "x.bag") as writer:
        connection = writer.add_connection("/fix", FIX_TYPE, typestore=store)
        rows = zip(
            fixes.stamps.tolist(),
            fixes.reading.fixes.places,
            fixes.reading.fixes.covariances,
            strict=True,
        )
        for number, (stamp, place, covariance) in enumerate(rows):
            time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            header = types["std_msgs/msg/Header"](number, time, "gps")
            status = types["sensor_msgs/msg/NavSatStatus"](2, 1)
            message = types[FIX_TYPE](header, status, *place, covariance.ravel(), 2)
            writer.write(connection, stamp, store.serialize_ros1(message, FIX_TYPE))
    assert_same_fixes(read_trajectory(f"{tmp_path / 'x.bag'}:/fix"), fixes)


def test_the_only_topic_of_poses_is_still_that(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "bag", antenna())
    assert read_trajectory(bag).name == "odom"


# Pairs at the groundtruth's stamps.


def test_equal_stamps_pair_alike_either_way() -> None:
    truth = FLIGHT.groundtruth[FLIGHT.groundtruth.stamps > FLIGHT.estimate.stamps[0]]
    estimate = truth
    points = dataclasses.replace(truth, quaternions=None)
    ates = [
        evaluate(points, estimate, Protocol(association=method, lengths=())).absolute.position_m
        for method in ("linear", "groundtruth-stamps", "auto")
    ]
    np.testing.assert_array_equal(ates[1], ates[2])
    np.testing.assert_array_equal(ates[0], ates[1])


@given(
    offset=st.integers(-(10**17), 10**17),
    part=st.integers(0, 10**8 - 1),
)
def test_a_point_on_a_straight_line_is_exact_whenever_it_was(offset: int, part: int) -> None:
    base = 10**18 + offset
    stamps = base + np.arange(20, dtype=np.int64) * 10**8
    estimate = Trajectory(stamps, np.outer(np.arange(20.0), [1.0, -2.0, 0.5]))
    points = Trajectory(stamps[:-1] + part, np.outer(np.arange(19) + part / 1e8, [1.0, -2.0, 0.5]))
    actual = evaluate(points, estimate, Protocol(gauge="none", lengths=()))
    assert len(actual.association) == 19
    assert actual.absolute.position_m.max() < 1e-9


def test_what_can_t_be_paired_is_counted_by_reason() -> None:
    stamps = np.array([0, 1, 2, 3, 20, 21], dtype=np.int64) * 10**8
    estimate = Trajectory(stamps, np.arange(18.0).reshape(-1, 3))
    points = Trajectory(
        np.array([-5, 0, 5, 15, 205, 215, 300], dtype=np.int64) * 10**7,
        np.arange(21.0).reshape(-1, 3),
    )
    actual = evaluate(points, estimate, Protocol(gauge="translation", lengths=()))
    pairs = actual.association
    assert pairs.dropped == {"before_estimate": 1, "after_estimate": 2}
    assert pairs.estimate_coverage is None
    assert pairs.groundtruth_coverage == pytest.approx(4 / 7)
    gap = points[2:5]
    pairs = evaluate(
        dataclasses.replace(gap, stamps=np.array([5, 100, 205], dtype=np.int64) * 10**7),
        estimate,
        Protocol(gauge="translation", lengths=()),
    ).association
    assert pairs.dropped == {"in_estimate_gap": 1}
    assert pairs.coverage.longest_gap is not None
    assert pairs.coverage.longest_gap.duration_s == pytest.approx(2.0)


def test_an_estimate_sparser_than_the_points() -> None:
    sparse = FLIGHT.estimate[::60]
    with pytest.raises(InputError, match="use association linear, or increase the max gap"):
        evaluate(antenna(), sparse, Protocol(gauge="yaw"))


def test_poses_are_paired_as_before() -> None:
    auto, linear = (
        evaluate(FLIGHT.groundtruth, FLIGHT.estimate, Protocol(association=method))
        for method in ("auto", "linear")
    )
    assert auto.association.rule.method == "linear"
    np.testing.assert_array_equal(auto.absolute.position_m, linear.absolute.position_m)


# Lever arms and gauges.


def test_a_lever_arm_takes_the_antenna_s_swing_out() -> None:
    truth = FLIGHT.groundtruth
    for lever, expected in ((LEVER, 0.002), (None, None)):
        actual = evaluate(antenna(), truth, Protocol(gauge="yaw", lever_m=lever, lengths=()))
        ate = actual.ate["position_m"]
        assert ate is not None
        if expected is not None:
            assert ate.rmse < expected
        else:
            assert ate.rmse > 0.1


def test_parts_of_the_error_add_up() -> None:
    actual = evaluate(antenna(), FLIGHT.estimate, Protocol(gauge="yaw"))
    parts = actual.absolute
    assert parts.horizontal_m is not None
    assert parts.vertical_m is not None
    np.testing.assert_allclose(np.hypot(parts.horizontal_m, parts.vertical_m), parts.position_m)


def test_relative_errors_need_no_orientation_where_gravity_is_known() -> None:
    actual = evaluate(antenna(40), FLIGHT.estimate, Protocol(gauge="yaw", lengths=(8, 16)))
    assert actual.protocol.re_form == "fitted"
    assert actual.relative is not None
    for item in actual.relative:
        assert len(item.errors.ends) > 20
        assert item.errors.rotation_deg is None
        assert item.statistics["rotation_deg"] is None
        assert item.statistics["position_percent"] is not None
    assert evaluate(antenna(40), FLIGHT.estimate, Protocol(gauge="se3")).relative is None


@pytest.mark.slow
@given(turn=st.floats(-3.0, 3.0), shift=st.floats(-1e4, 1e4))
def test_the_ate_is_the_same_in_any_level_frame(turn: float, shift: float) -> None:
    fixes = antenna()
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    moved = Trajectory(fixes.stamps, fixes.positions @ rotation.T + shift)
    protocol = Protocol(gauge="yaw", lengths=())
    one, other = (evaluate(item, FLIGHT.estimate, protocol) for item in (fixes, moved))
    np.testing.assert_allclose(one.absolute.position_m, other.absolute.position_m, atol=1e-9)


# As a user would.


def test_one_command_on_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = bag_of(tmp_path / "bag", antenna())
    words = ["evaluate", "-g", f"{bag}:/fix", "-e", f"{bag}:/odom"]
    lever = ",".join(map(str, LEVER))
    assert main([*words, "--lever-arm", lever, "--lengths", "8"]) == 0
    printed = capsys.readouterr()
    assert "gauge yaw by default" in printed.out
    assert "of 40 fixes (" in printed.out
    assert "noise-corrected ATE" in printed.out
    assert "vertical [m]" in printed.out
    assert "lever arm" not in printed.err
    assert main(words) == 0
    assert "give the lever arm" in capsys.readouterr().err
    assert main([*words, "--json", "-", "--datum", str(DATUM), "--max-fix-sigma", "0.05"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["groundtruth"]["kind"] == "gnss"
    assert result["groundtruth"]["fixes"]["datum"] == dataclasses.asdict(DATUM)
    (one,) = result["runs"]
    assert one["association"]["method"] == "groundtruth-stamps"
    assert one["alignment"]["gauge"] == "yaw"
    assert one["noise_corrected_ate"]["fixes"] == one["association"]["pairs"]
    assert main(["info", bag]) == 0
    assert (
        "/fix: 40 of status 2; standard deviation 0.02 to 0.02 m horizontal"
        in capsys.readouterr().out
    )


def test_a_bag_alone_gives_what_its_repeated_command_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(bag_of(tmp_path / "bag", antenna()))]) == 0
    alone, _, command = capsys.readouterr().out.partition("\nrepeat: trajeval ")
    assert "noise-corrected ATE" in alone
    assert main(shlex.split(command)) == 0
    assert capsys.readouterr().out == alone


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--lever-arm", "1,2"], "the lever arm '"),
        (["--lever-arm", "1,2,nan"], "the lever arm '"),
        (["--lever-arm", "0,0,1", "--hand-eye", "auto"], "give one of them"),
        (["--lever-arm", "0,0,1", "--gauge", "sim3"], "gauge sim3 has a free scale"),
        (["--datum", "here"], "datum 'here' is not valid"),
        (["--min-fix-status", "3"], "minimum fix status"),
        (["--max-fix-sigma", "0.001"], "no usable fix among 40 (40 fix sigma above"),
        (["--align-weights", "fixes"], "unknown alignment weighting 'fixes'"),
    ],
)
def test_bad_words_are_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(tmp_path / "bag", antenna())
    assert main(["evaluate", "-g", f"{bag}:/fix", "-e", f"{bag}:/odom", *words]) == 2
    printed = capsys.readouterr().err
    assert sentence in printed
    assert len(printed.splitlines()) == 1


def test_weights_need_the_covariances_that_they_are_made_of() -> None:
    rows = quality(len(antenna()), kind=0)
    fixes = antenna()
    unknown = fixes_of(fixes.stamps, fixes.positions, rows)
    protocol = Protocol(gauge="yaw", align_weights="groundtruth-covariance", lengths=())
    with pytest.raises(InputError, match="has pairs without a position covariance"):
        evaluate(unknown, FLIGHT.estimate, protocol)


def test_weights_prefer_the_fixes_that_claim_to_be_good() -> None:
    fixes = antenna()
    rows = quality(len(fixes))
    positions, bad = fixes.positions.copy(), slice(5, 20)
    rows[bad, 2:] *= 10000.0  # 2 m
    positions[bad, 0] += 2.0
    mixed = fixes_of(fixes.stamps, positions, rows)
    good = np.r_[0:5, 20 : len(fixes)]
    errors = []
    for weights in ("none", "groundtruth-covariance"):
        protocol = Protocol(gauge="yaw", lever_m=LEVER, align_weights=weights, lengths=())
        actual = evaluate(mixed, FLIGHT.groundtruth, protocol)
        errors.append(actual.absolute.position_m[good].max())
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize(
    ("origin", "is_utm"),
    [
        ((465_000.0, 5_249_000.0, 430.0), True),
        ((5_249_000.0, 465_000.0, 430.0), True),
        ((465_000.0, 249_000.0, 430.0), False),
        ((2_683_000.0, 1_247_000.0, 430.0), False),  # LV95, of Switzerland
        ((0.0, 0.0, 0.0), False),
    ],
)
def test_utm_is_told(origin: tuple[float, float, float], is_utm: bool) -> None:
    flight = simulate(seed=8, duration_s=20.0)
    truth = dataclasses.replace(
        flight.groundtruth, positions=flight.groundtruth.positions + np.array(origin)
    )
    actual = evaluate(truth, flight.estimate, Protocol(gauge="yaw"))
    told = [warning for warning in actual.warnings if "UTM" in warning]
    assert len(told) == is_utm
    if told:
        assert told[0].startswith("the groundtruth is probably in UTM coordinates (easting 46")


@pytest.mark.parametrize(
    ("origin", "is_centred"),
    [
        ((4_194_000.0, 702_000.0, 4_739_000.0), True),  # Munich
        ((-2_700_000.0, -4_290_000.0, 3_855_000.0), True),  # San Francisco
        ((465_000.0, 6_354_000.0, 430.0), False),  # UTM of 57.3 degrees north
        ((0.0, 0.0, 0.0), False),
    ],
)
def test_earth_centred_coordinates_have_no_up_axis(
    origin: tuple[float, float, float], is_centred: bool
) -> None:
    flight = simulate(seed=8, duration_s=20.0)
    truth = dataclasses.replace(
        flight.groundtruth, positions=flight.groundtruth.positions + np.array(origin)
    )
    evaluation = evaluate(truth, flight.estimate, Protocol(gauge="se3"))
    stated = [text for text in evaluation.warnings if "(ECEF)" in text]
    assert bool(stated) == is_centred
    assert (evaluation.ate["tilt_deg"] is None) == is_centred
    assert evaluation.ate["rotation_deg"] is not None
    assert not is_centred or not any("UTM" in text for text in evaluation.warnings)


@pytest.mark.parametrize(
    ("settings", "gauge"),
    [
        ({}, Gauge.YAW),
        ({"modality": "lidar"}, Gauge.YAW),
        ({"modality": "stereo"}, Gauge.SE3),
        ({"modality": "lidar", "gauge": "se3"}, Gauge.SE3),
        ({"modality": "lidar", "protocol": "evo"}, Gauge.SE3),
    ],
)
def test_heights_of_fixes_tilt_no_lidar(settings: dict[str, str], gauge: Gauge) -> None:
    flight = simulate(seed=1, duration_s=20.0)
    fixes = fixes_of(flight.groundtruth.stamps[::20], flight.groundtruth.positions[::20])
    request = request_from(settings).for_trajectories(fixes, [flight.estimate])
    assert request.protocol.gauge is gauge
    other = request_from(settings).for_trajectories(flight.groundtruth, [flight.estimate])
    assert other.protocol.gauge is Gauge.SE3
    live = OnlineSettings(protocol=Protocol(modality="lidar"))
    assert live.with_gauge(Gauge.SE3) is live
    assert live.with_gauge(Gauge.YAW).protocol.gauge is Gauge.YAW


@pytest.mark.slow
def test_noisy_fixes_of_a_slow_robot_are_not_of_another_run(
    shared_data: Path, tmp_path: Path
) -> None:
    bag = shared_data / "gnss" / "husky_outdoor.bag"
    actual = {}
    for name in ("fix", "shifted"):
        source, options = f"{bag}:/fix", ["--modality", "wheel", "--lengths", "none"]
        if name == "shifted":  # two minutes later, the robot is elsewhere
            options += ["--time-offset", "120"]
        file = tmp_path / f"{name}.json"
        estimate = f"{bag}:/husky_velocity_controller/odom"
        assert main(["evaluate", source, estimate, *options, "--json", str(file)]) == 0
        [run] = json.loads(file.read_text())["runs"]
        actual[name] = {finding["cause"] for finding in run["diagnosis"]}
    assert "other_run" not in actual["fix"]
    assert actual["shifted"] & {"other_run", "clock_offset"}


def test_bad_rules_are_refused() -> None:
    for bad in ({"min_status": 5}, {"max_sigma_m": 0.0}, {"correlation_s": 0.0}):
        with pytest.raises(SettingsError):
            FixRule(**bad)  # type: ignore[arg-type]
