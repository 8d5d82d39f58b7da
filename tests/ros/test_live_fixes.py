"""Live fixes without a network: bytes in any batches, and what `finish` makes of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fix_runs import DATUM, fix_messages, fixes_of, later, quality
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from marker_flights import write_mounting
from recorded_runs import pairs_of
from ros_bags import ODOM, Message, messages_of, write_messages
from ros_processes import assert_same, offline

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.pose_messages import FIX_TYPE
from trajeval_ros.io.requests.request_from import known_hand_eye
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.recorded_state import write_states

FLIGHT = simulate(seed=8, duration_s=40.0)
LEVER = (0.3, -0.1, 0.5)
LEVER_TEXT = ",".join(map(str, LEVER))


def antenna(lever_m: Sequence[float] = LEVER) -> Trajectory:
    """Return fixes 2.5 times a second, some of them bad by their own account."""
    groundtruth = FLIGHT.groundtruth[::80]
    assert groundtruth.rotations is not None
    rows = quality(len(groundtruth))
    rows[10:20, 2:] *= 400.0
    positions = groundtruth.positions + groundtruth.rotations.apply(lever_m)
    return fixes_of(groundtruth.stamps, positions, rows)


def messages(
    estimate: Trajectory = FLIGHT.estimate[60:],
    late_s: float = 0.0,
    lever_m: Sequence[float] = LEVER,
) -> list[Message]:
    """Return fixes and odometry as they arrive, the fixes later by a constant."""
    both = later(fix_messages(antenna(lever_m), GROUNDTRUTH), late_s) + messages_of(
        estimate, ESTIMATE, ODOM
    )
    return sorted(both, key=lambda item: item[2])


def fed(folder: Path, late_s: float, rule: FixRule, **words: Any) -> Live:
    """Return a live run that has heard everything."""
    feed = messages(late_s=late_s)
    live = Live(folder, ODOM, groundtruth_kind=FIX_TYPE, **words)
    live.groundtruth.stream.fixes = LiveFixes(rule)
    for begin in range(0, len(feed), 37):
        live.feed(feed[begin : begin + 37])
    return live


ARM = ",".join(map(str, LEVER))
WORDS = ("--lengths", "2,4", "--lever-arm", ARM)
YAW = ("--gauge", "yaw")


def recorded(folder: Path, feed: Sequence[Message], *options: str) -> Any:
    """Return the result that a recording of messages has."""
    folder.mkdir()
    write_messages(folder / "bag", feed)
    return offline(folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], *WORDS, *options)


@pytest.mark.parametrize("late_s", [0.0, 3.0])
@pytest.mark.parametrize(
    ("rule", "options"),
    [
        (FixRule(), []),
        (
            FixRule(datum=DATUM, max_sigma_m=0.05, min_status=2, correlation_s=20.0),
            [
                "--datum", str(DATUM), "--max-fix-sigma", "0.05", "--min-fix-status", "2",
                "--fix-correlation", "20",
            ],
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("gauge", ["", "planar"])
def test_live_is_offline(
    rule: FixRule, options: list[str], gauge: str, late_s: float, tmp_path: Path
) -> None:
    live = fed(tmp_path / "live", late_s, rule, lever_arm=LEVER_TEXT, gauge=gauge or None)
    live.end()
    result = live.result
    options = [*options, *(["--gauge", gauge] if gauge else [])]
    expected = recorded(tmp_path / "recorded", messages(), *options)
    assert_same(result, expected)
    assert_same(result["groundtruth"]["fixes"], expected["groundtruth"]["fixes"])
    [run] = result["runs"]
    assert run["noise_corrected_ate"] is not None
    assert run["association"]["method"] == "groundtruth-stamps"
    snapshot = live.run.estimates[0].snapshot()
    ate, coverage = run["ate"], snapshot.coverage
    assert snapshot.position_rmse_m == pytest.approx(ate["position_m"]["rmse"], rel=1e-9)
    assert coverage is not None
    assert coverage.covered == run["association"]["groundtruth_coverage"]
    assert [item.text for item in live.run.news] == (
        [] if gauge else ["/groundtruth: GNSS fixes; the alignment uses gauge yaw"]
    )


@pytest.mark.slow
def test_the_antenna_of_a_hand_eye_transform_is_that_of_a_recording(tmp_path: Path) -> None:
    file = str(write_mounting(tmp_path))
    mounting = known_hand_eye(file)
    body, lever_m = MarkerBody(file, mounting), mounting.lever_m
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE, body=body)
    for message in messages(late_s=1.0, lever_m=lever_m):
        live.feed([message])
    live.end()
    write_messages(tmp_path / "bag", messages(lever_m=lever_m))
    words = ("--lengths", "2,4", "--hand-eye", file, *YAW)
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *words)
    [run] = expected["runs"]
    run["calibration"]["ate"]["before"] = None  # live, nobody pairs the body
    assert_same(live.result, expected)
    assert run["calibration"]["errors_of"] == "marker"
    assert not any("no lever arm is given" in remark["text"] for remark in run["remarks"])


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 19, 1000])
def test_each_loop_is_a_run(tmp_path: Path, batch: int) -> None:
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE, lever_arm=LEVER_TEXT)
    live.groundtruth.stream.fixes = LiveFixes(FixRule(DATUM))
    feed = messages()
    for begin in range(0, 2 * len(feed), batch):
        live.feed([*feed, *feed][begin : begin + batch])
    live.end()
    [expected] = recorded(tmp_path / "recorded", feed, "--datum", str(DATUM), *YAW)["runs"]
    assert len(live.folders) == 2
    for result in live.results:
        assert_same(result["runs"], [expected])


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 19, 1000])
def test_a_restart_parts_the_fixes(tmp_path: Path, batch: int) -> None:
    positions = FLIGHT.estimate.positions.copy()
    positions[350:] += [30.0, -20.0, 10.0]
    # While it restarts, nothing comes for 2 s.
    estimate = dataclasses.replace(FLIGHT.estimate, positions=positions)
    kept = (np.arange(len(estimate)) < 310) | (np.arange(len(estimate)) >= 350)
    feed = messages(estimate[np.flatnonzero(kept)])
    live = Live(
        tmp_path / "live",
        ODOM,
        groundtruth_kind=FIX_TYPE,
        lever_arm=LEVER_TEXT,
        at_restarts=True,
    )
    live.groundtruth.stream.fixes = LiveFixes(FixRule(DATUM))
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    paired = [pairs_of(item).estimate.stamps for item in live.folders]
    first = int(paired[1][0])
    around = [item[2] for item in feed if item[0] == ESTIMATE]
    before, after = max(s for s in around if s <= first), min(s for s in around if s >= first)
    parts = [
        [item for item in feed if item[2] <= (after if item[0] == ESTIMATE else first - 1)],
        [item for item in feed if item[2] >= (before if item[0] == ESTIMATE else first)],
    ]
    outcome = [result["runs"][0] for result in live.results]
    for number, (run, part) in enumerate(zip(outcome, parts, strict=True)):
        folder = tmp_path / str(number)
        [expected] = recorded(folder, part, "--datum", str(DATUM), *YAW)["runs"]
        assert_same(run, expected)
    assert outcome[0]["association"]["dropped"]["in_estimate_gap"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["some", "all"])
@pytest.mark.parametrize("gauge", ["planar", "yaw"])
def test_fixes_without_height_are_used_as_offline(
    missing: str, gauge: str, tmp_path: Path
) -> None:
    fixes = antenna()
    assert fixes.reading.fixes is not None
    fixes.reading.fixes.places[slice(None, None, 3 if missing == "some" else 1), 2] = np.nan
    feed = [*fix_messages(fixes, GROUNDTRUTH), *messages_of(FLIGHT.estimate, ESTIMATE, ODOM)]
    feed.sort(key=lambda item: item[2])
    live = Live(
        tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE, gauge=gauge, lever_arm=LEVER_TEXT
    )
    live.groundtruth.stream.fixes = LiveFixes(gauge=Gauge.of(gauge))
    for begin in range(0, len(feed), 7):
        live.feed(feed[begin : begin + 7])
    live.end()
    if (missing, gauge) == ("all", "yaw"):
        assert (
            "the fixes have no height; use gauge:=planar" in live.groundtruth.stream.trouble.text
        )
        assert live.run.estimates[0].evaluator.pairs == 0
        return
    result = live.result
    expected = recorded(tmp_path / "recorded", feed, "--gauge", gauge)
    assert_same(result, expected)
    assert_same(result["groundtruth"]["fixes"], expected["groundtruth"]["fixes"])
    dropped = len(fixes) - len(fixes) * 2 // 3 if gauge == "yaw" else 0
    assert result["groundtruth"]["fixes"]["dropped"].get("no_height", 0) == dropped


def test_a_sparse_estimate_that_bends_is_told_live_as_offline(tmp_path: Path) -> None:
    keyframes = FLIGHT.estimate[::8]  # 0.4 s apart
    feed = messages(keyframes)
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE, lever_arm=LEVER_TEXT)
    for begin in range(0, len(feed), 7):
        live.feed(feed[begin : begin + 7])
    live.end()
    expected = recorded(tmp_path / "recorded", feed, *YAW)
    assert_same(live.result, expected)
    [run] = expected["runs"]
    assert any("linear interpolation between" in remark["text"] for remark in run["remarks"])


def test_a_datum_on_another_continent_is_told(tmp_path: Path) -> None:
    live = fed(tmp_path / "live", 0.0, FixRule(datum=Datum(8.5, 47.4, 430.0)))
    assert "5477 km away from the first fix" in live.groundtruth.stream.trouble.text
    assert live.groundtruth.stream.status.dropped == {"no_frame": len(antenna())}
    assert live.run.estimates[0].evaluator.pairs == 0


def test_gauge_none_wants_a_datum(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE, gauge="none")
    live.groundtruth.stream.fixes = LiveFixes(gauge=Gauge.NONE)
    live.feed(messages())
    assert (
        "give the origin of the estimate's frame with datum:="
        in live.groundtruth.stream.trouble.text
    )


def test_two_receivers_on_one_topic_are_told_once(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE)
    one, other = (fix_messages(antenna(), GROUNDTRUTH, name) for name in ("left", "right"))
    mixed = [pair[row % 2] for row, pair in enumerate(zip(one, other, strict=True))]
    for begin in range(0, len(mixed), 7):
        live.feed(mixed[begin : begin + 7])
    told = [
        item.text
        for item in live.groundtruth.stream.news
        if "fixes of several receivers" in item.text
    ]
    assert len(told) == 1
    assert "(frame_id 'left', 'right')" in told[0]
    assert any(
        "fixes of several receivers" in remark.text
        for remark in live.groundtruth.stream.status.remarks
    )


def test_a_fix_is_silent_by_its_own_period(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE)
    assert live.groundtruth.stream.patience_s == 5.0
    live.feed(fix_messages(antenna()[::25], GROUNDTRUTH))  # each 10 s
    assert live.groundtruth.stream.patience_s == pytest.approx(30.0, rel=0.01)


def test_what_was_paired_outlives_a_kill(tmp_path: Path) -> None:
    live = fed(tmp_path / "live", 0.0, FixRule(), lever_arm=LEVER_TEXT)
    # No end: what waits is never decided, and the newest counts are those of the beginning.
    write_states(live.run)
    (run,) = live.result["runs"]
    assert run["association"]["method"] == "groundtruth-stamps"
    assert run["association"]["pairs"] > 80


@pytest.mark.slow
def test_finish_does_not_ask_for_a_gauge(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    live = fed(tmp_path / "live", 0.0, FixRule(), lever_arm=LEVER_TEXT)
    live.end()
    assert main(["finish", str(live.folder)]) == 0
    text = capsys.readouterr().out
    assert "aligned by yaw" in text
    assert "--modality" not in text


def test_fixes_that_are_none_are_counted_and_told(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM, groundtruth_kind=FIX_TYPE)
    fixes = antenna()
    assert fixes.reading.fixes is not None
    fixes.reading.fixes.status[:] = -1
    live.feed(fix_messages(fixes, GROUNDTRUTH))
    assert live.groundtruth.stream.status.dropped == {"no_fix": len(fixes)}
    assert "no message with a valid pose" in live.groundtruth.stream.trouble.text
    assert live.groundtruth.stream.fixes.datum is None
    assert not (live.folder / "groundtruth.fixes").exists()


def test_parameters_are_the_command_line_s() -> None:
    pytest.importorskip("trajeval_ros.ros.parameters")
    from trajeval_ros.ros import parameters
    from trajeval_ros.ros.parameter_table import PARAMETERS

    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    assert parameters.request_of(values).fixes == FixRule()
    values |= {"datum": str(DATUM), "min_fix_status": 2.0, "max_fix_sigma": 0.05}
    values |= {"lever_arm": "0.3,-0.1,0.5"}
    assert parameters.request_of(values).fixes == FixRule(DATUM, 2, 0.05, 100.0)
    assert parameters.settings_of(values).protocol.lever_m == LEVER
    np.testing.assert_array_equal(DATUM.coordinates, [47.4, 8.5, 430.0])
