"""Files of a live run: what is written is read, and what is no state of a run is refused."""

from __future__ import annotations

import copy
import dataclasses
import errno
import os
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pair_file_contents import COUNT, DESCRIPTION, STATE, STEP_NS, columns
from strategies import make_groundtruth

from trajeval_ros import Protocol
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live import chunk_file
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks, read_tables
from trajeval_ros.io.live.fix_file import FixWriter, read_fix_rows
from trajeval_ros.io.live.pair_file import (
    PairWriter,
    RecordedPairs,
    read_pairs,
    read_revised,
    write_revised,
)
from trajeval_ros.io.live.reception_file import RecordedAvailability, read_received
from trajeval_ros.io.live.recorded_association import (
    all_groundtruth,
    recorded_association,
    revised_association,
)
from trajeval_ros.io.live.run_state import recorded_remarks, require_run_state
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.metrics.coverage import StampedPoses

UPS = [UpAxis("z"), UpAxis("z")]
KINDS = {
    b"ONE_": np.dtype([("stamp", "<i8"), ("value", "<f8", 2)]),
    b"TWO_": np.dtype([("stamp", "<i8")]),
}
WAITING = chunk_file._MOST_WAITING


@settings(max_examples=20)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5)), max_size=8))
def test_tables_of_all_kinds_are_read_as_written(
    tmp_path_factory: pytest.TempPathFactory, chunks: list[tuple[bool, int]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "tables"
    path.unlink(missing_ok=True)
    writer = ChunkWriter(path, KINDS, {"format": "tables/1"})
    one, two, count = [], [], 0
    for is_one, rows in chunks:
        stamps = np.arange(count, count + rows) - 3
        count += rows
        if is_one:
            one.append(stamps)
            writer.add(b"ONE_", stamps, np.column_stack([stamps / 2, -stamps]), text={"at": count})
        else:
            two.append(stamps)
            writer.add(b"TWO_", stamps)
    writer.close()
    tables = read_tables(path, KINDS, "tables/1", "table")
    expected = np.concatenate([np.zeros(0), *one])
    first, second = (tables[b"ONE_"][name].tolist() for name in KINDS[b"ONE_"].names or ())
    assert (first, second) == (
        expected.tolist(),
        np.column_stack([expected / 2, -expected]).tolist(),
    )
    [name] = KINDS[b"TWO_"].names or ()
    assert tables[b"TWO_"][name].tolist() == np.concatenate([np.zeros(0), *two]).tolist()
    found, rest = read_chunks(path, KINDS)
    assert rest == 0
    assert [len(rows) for _, rows in found] == [0, *(rows for _, rows in chunks)]
    with pytest.raises(InputError, match="tables has schema tables/1"):
        read_tables(path, KINDS, "tables/2", "table")


@pytest.mark.parametrize("more", [0, 1])
def test_a_chunk_waits_if_there_is_memory_for_it(tmp_path: Path, more: int) -> None:
    assert WAITING == 64 * 1024 * 1024
    writer = ChunkWriter(tmp_path / "x", KINDS, {"format": "tables/1"})
    with mock.patch.object(chunk_file, "_MOST_WAITING", 16 + 80 + 8 * 3):
        assert writer.add(b"TWO_", np.zeros(10, dtype=np.int64))
        assert writer.add(b"TWO_", np.zeros(3 + more, dtype=np.int64)) == (not more)
    writer.close()
    stamps = read_tables(tmp_path / "x", KINDS, "tables/1", "table")[b"TWO_"]
    assert len(stamps) == (10 if more else 13)


def test_trouble_of_the_disk_at_the_end_is_told(tmp_path: Path) -> None:
    for place, fails in enumerate(("fsync", "write", "nothing")):
        writer = ChunkWriter(tmp_path / str(place), KINDS, {"format": "tables/1"})
        writer.add(b"TWO_", np.zeros(1, dtype=np.int64))
        error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if fails == "nothing":
            writer.close()
            assert writer.trouble == ""
            continue
        with (
            mock.patch.object(os, fails, side_effect=error),
            pytest.raises(InputError, match="can't be written completely: no space left"),
        ):
            writer.close()
    writer = ChunkWriter(tmp_path / "both", KINDS, {"format": "tables/1"})
    writer.add(b"TWO_", np.zeros(1, dtype=np.int64))
    other = OSError(errno.EIO, os.strerror(errno.EIO))
    with (
        mock.patch.object(os, "write", side_effect=error),
        mock.patch.object(os, "fsync", side_effect=other),
        pytest.raises(InputError, match="no space left"),  # the first of the two
    ):
        writer.close()


def test_fixes_are_read_as_written(tmp_path: Path) -> None:
    writer, rng = FixWriter(tmp_path), np.random.default_rng(0)
    rows = rng.normal(size=(7, 14))
    for part in (slice(0, 3), slice(3, 7)):
        writer.append(np.arange(7)[part], rows[part])
    writer.close()
    stamps, found = read_fix_rows(tmp_path)
    assert stamps.tolist() == list(range(7))
    np.testing.assert_array_equal(found, rows)


def test_receptions_are_read_as_written_each_with_its_up_axis(tmp_path: Path) -> None:
    truth, estimate = make_groundtruth(1, 9), make_groundtruth(2, 5)
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    writer = RecordedAvailability(tmp_path / "x.received", AvailabilityRule("hold"), 0.5, 10.0)
    writer.add_groundtruth(truth.stamps, np.hstack([truth.positions, truth.quaternions]))
    times = estimate.stamps + 12
    rows = np.hstack([estimate.positions, estimate.quaternions])
    rates, velocities = np.arange(30.0).reshape(2, 5, 3)
    corrected = times - 7
    rows = np.hstack([rows, velocities])
    received = Receptions(times, "node", None, rates, corrected)
    writer.add_estimate(estimate.stamps, rows, received)
    writer.close()
    found = read_received(tmp_path / "x.received", [UpAxis("y"), UpAxis("-z")])
    for one, other, up in zip(found, (truth, estimate), ("y", "-z"), strict=True):
        np.testing.assert_array_equal(one.stamps, other.stamps)
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_allclose(one.quaternions, other.quaternions, atol=1e-15)  # type: ignore[arg-type]
        assert one.up.name == up
    assert found[0].reading.receptions is None
    receptions = found[1].reading.receptions
    assert receptions is not None
    assert receptions.times.tolist() == times.tolist()
    assert receptions.corrected is not None
    assert receptions.corrected.tolist() == corrected.tolist()
    np.testing.assert_array_equal(receptions.body_rates, rates)
    np.testing.assert_array_equal(found[1].velocities, velocities)


def test_revised_poses_are_read_as_written(tmp_path: Path) -> None:
    source, path = make_groundtruth(3, 8), tmp_path / "x.npz"
    assert source.quaternions is not None
    parts = source.stamps, source.positions, source.quaternions
    write_revised(path, *parts)
    found = read_revised(path)
    np.testing.assert_array_equal(found.stamps, source.stamps)
    np.testing.assert_array_equal(found.positions, source.positions)
    np.testing.assert_allclose(found.quaternions, source.quaternions, atol=1e-15)  # type: ignore[arg-type]
    for wrong in (
        (parts[0][:7], *parts[1:]),
        (parts[0], parts[1][:, :2], parts[2]),
        (parts[0], parts[1], parts[2][:7]),
        (parts[0].astype(float), *parts[1:]),
        tuple(each[:0] for each in parts),
        (np.array(3), *parts[1:]),
        (parts[0], parts[1] * np.nan, parts[2]),
        (parts[0], parts[1], parts[2] * 0.0),
    ):
        write_revised(path, *wrong)
        with pytest.raises(InputError, match=r"must have equal numbers|are not finite"):
            read_revised(path)


def recorded(**changes: Any) -> RecordedPairs:
    """Return what a pair file of a whole flight has."""
    stamps, groundtruth, estimate = columns()
    full = RecordedPairs(
        description=DESCRIPTION,
        state=copy.deepcopy(STATE),
        pairs_at_state=COUNT,
        stamps=stamps,
        groundtruth=groundtruth,
        estimate=estimate,
        covariances=None,
        waypoints=StampedPoses(np.zeros(0, dtype=np.int64), np.zeros((0, 7))),
        torn=0,
    )
    return dataclasses.replace(full, **changes)


def waypoints(*seconds: float) -> StampedPoses:
    stamps = columns()[0][0] + np.round(np.array(seconds) * 1e9).astype(np.int64)
    poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(seconds), 1))
    poses[:, 0] = seconds
    return StampedPoses(stamps, poses)


def test_pairs_are_in_order_and_counted_once() -> None:
    full = recorded()
    again = np.r_[150:170, 0:150, 160:COUNT, 20:22]
    order = {name: getattr(full, name)[again] for name in ("stamps", "groundtruth", "estimate")}
    order["groundtruth"] = order["groundtruth"].copy()
    order["groundtruth"][3, 1] = np.nan  # of stamp 153, whose second one is not there
    covariances = np.tile(np.eye(6), (len(again), 1, 1)) * (1.0 + again[:, None, None])
    changed = recorded(**order, covariances=covariances, pairs_at_state=len(again) - 5)
    found = recorded_association(changed, Protocol(gauge="yaw"), UPS)
    kept = np.delete(np.arange(COUNT), 153)
    np.testing.assert_array_equal(found.groundtruth.stamps, full.stamps[kept])
    np.testing.assert_array_equal(found.estimate.positions, full.estimate[kept, :3])
    assert found.estimate.covariances is not None
    np.testing.assert_array_equal(found.estimate.covariances[:, 0, 0], 1.0 + kept)
    repeated = len(again) - 1 - len(kept)
    assert found.dropped == {"duplicate_stamp": repeated, "not_finite": 1}
    # Pairs after the last counts are states, too; repeated ones are not.
    assert found.estimate_coverage == len(kept) / (COUNT + 5 - repeated)


@pytest.mark.parametrize(("first", "is_start"), [(None, True), (0, True), (1, False), (-1, False)])
def test_pairs_are_from_the_start_if_the_first_state_has_one(
    first: int | None, *, is_start: bool
) -> None:
    full = recorded()
    if first is not None:
        full.state["estimate"]["first_stamp_ns"] = int(full.stamps[0]) + first
    assert recorded_association(full, Protocol(gauge="yaw"), UPS).from_the_start == is_start


def test_groundtruth_between_pairs_is_part_of_the_path() -> None:
    full = recorded(waypoints=waypoints(1.01, 0.02, 3.0, 5.01))
    full.waypoints.poses[3] = np.nan
    pairs = recorded_association(full, Protocol(gauge="yaw"), UPS)
    whole = all_groundtruth(pairs, full)
    added = [full.waypoints.stamps[1], full.waypoints.stamps[0]]
    expected = sorted([*full.stamps.tolist(), *added])
    assert whole.stamps.tolist() == expected  # that at 3 s is one of the pairs
    row = expected.index(int(added[0]))
    assert whole.positions[row, 0] == 0.02
    row = expected.index(int(full.stamps[60]))
    np.testing.assert_array_equal(whole.positions[row], full.groundtruth[60, :3])


@pytest.mark.parametrize("counted_ns", [0, STEP_NS * COUNT, 2 * STEP_NS * COUNT])
def test_the_time_of_the_groundtruth_is_at_least_that_of_its_waypoints(counted_ns: int) -> None:
    """A killed run has older counts than pairs."""
    full = recorded(waypoints=waypoints(*(0.05 * np.arange(COUNT) + 0.01)))
    full.state["groundtruth"]["time_without_gaps_ns"] = counted_ns
    coverage = recorded_association(full, Protocol(gauge="yaw"), UPS).coverage
    passed_ns = STEP_NS * (COUNT - 1)
    covered_ns = passed_ns - 10_000_000  # from the first waypoint to the last pair
    expected = covered_ns / max(counted_ns, passed_ns)
    assert coverage.covered == pytest.approx(expected, rel=1e-12)
    assert coverage.span == pytest.approx(expected, rel=1e-12)


def test_revised_poses_replace_those_of_the_pairs(tmp_path: Path) -> None:
    full, path = recorded(), tmp_path / "x.npz"
    causal = recorded_association(full, Protocol(gauge="yaw"), UPS)
    rows = np.r_[10:60, 80:COUNT]
    stamps = np.concatenate([full.stamps[rows], full.stamps[-1:] + 2_000_000_000])
    positions = np.concatenate([full.estimate[rows, :3] + 1.0, [[0.0, 0.0, 0.0]]])
    turns = np.tile([0.0, 0.0, 0.6, 0.8], (len(stamps), 1))
    write_revised(path, stamps, positions, turns)
    found, counts = revised_association(causal, full, path)
    np.testing.assert_array_equal(found.groundtruth.stamps, full.stamps[rows])
    np.testing.assert_array_equal(found.groundtruth.positions, full.groundtruth[rows, :3])
    np.testing.assert_array_equal(found.estimate.positions, positions[:-1])
    assert found.estimate_coverage == len(rows) / (len(rows) + 1)
    assert found.dropped == {"without_pair_when_first_published": 1}
    span_ns = int(stamps[-1] - stamps[0])
    assert (counts["poses"], counts["duration_s"]) == (len(stamps), span_ns / 1e9)
    # If the causal counts explain the poses without a pair, they are kept.
    dropped = {"after_groundtruth": 1, "duplicate_stamp": 4}
    explained = dataclasses.replace(causal, dropped=dropped)
    assert revised_association(explained, full, path)[0].dropped == dropped
    more = {"after_groundtruth": 2, "duplicate_stamp": 4}
    unexplained = dataclasses.replace(causal, dropped=more)
    assert revised_association(unexplained, full, path)[0].dropped == {
        "duplicate_stamp": 4,
        "without_pair_when_first_published": 1,
    }


RESETS = "estimate.resets"
REMARK = {"level": "warning", "code": "a", "text": "b"}


@pytest.mark.parametrize(
    ("key", "good", "bad"),
    [
        ("place", [0, 3], [-1, 1.0, "1", None, True]),
        ("groundtruth", ["/a", ""], [1, None]),
        ("estimate.poses", [0, 7], [-1, 0.5, None, False]),
        ("groundtruth.duration_s", [0, 0.0, 2.5], [-0.1, "1", None, True]),
        ("estimate.frame", ["", "odom"], [None, 1]),
        ("groundtruth.path_length_m", [0, 1.5], [-1.0, None]),
        ("groundtruth.time_without_gaps_ns", [0, 10**18], [0.5, -1]),
        ("groundtruth.dropped", [{}, {"a": 1}], [None, [], {"a": -1}, {"a": 0.5}]),
        ("aligned_by", [None, 1, 40], [0, -1, 1.0]),
        ("settings", [{}], [None, []]),
        ("warnings", [[], ["text"], [REMARK]], [None, {}, [1], [{**REMARK, "level": "x"}],
            [{**REMARK, "text": 1}], [{"level": "note"}], [{**REMARK, "more": ""}]]),
        ("estimate.notes", [[REMARK, "text"]], ["text", [None]]),
        ("estimate.up", [{"name": "-y", "origin": "x"}],
            [None, {"name": "w", "origin": "x"}, {"name": "z"}, {"name": "z", "origin": 1}]),
        (RESETS, [None, [], [[5, 0.5, 1]]],
            [{}, [5], [[5, 0.5]], [[5, 0.5, 1, 1]], [[5.0, 0.5, 1]], [[5, -0.5, 1]],
             [[5, 0.5, "1"]]]),
    ],
)  # fmt: skip
def test_states_of_a_run_have_values_of_their_types(
    key: str, good: list[Any], bad: list[Any]
) -> None:
    for value, is_good in [*((each, True) for each in good), *((each, False) for each in bad)]:
        description, state = copy.deepcopy(DESCRIPTION), copy.deepcopy(STATE)
        place = description if key in ("place", "groundtruth") else state
        *outer, last = key.split(".")
        for name in outer:
            place = place[name]
        place[last] = value
        if is_good:
            require_run_state(description, state)
            continue
        with pytest.raises(ValueError, match=rf"{key} can't be "):
            require_run_state(description, state)


def test_a_missing_part_of_a_state_is_named() -> None:
    for key in ("estimate", "groundtruth", "dropped", "live"):
        state = {name: value for name, value in STATE.items() if name != key}
        with pytest.raises(ValueError, match=f"{key}.* can't be None"):
            require_run_state(DESCRIPTION, state)


def test_sentences_of_old_files_get_a_level() -> None:
    [old, new] = recorded_remarks(["text", REMARK], Level.NOTE)
    assert (old.level, old.code, old.text) == (Level.NOTE, "live_run", "text")
    assert (new.level, new.code, new.text) == (Level.WARNING, "a", "b")


def test_covariances_are_kept_where_they_are_known(tmp_path: Path) -> None:
    stamps, groundtruth, estimate = (each[:6] for each in columns())
    wide = np.hstack([estimate, np.random.default_rng(0).normal(size=(6, 36))])
    writer = PairWriter(tmp_path / "x.pairs", DESCRIPTION)
    writer.append(stamps[:2], groundtruth[:2], wide[:2])
    writer.append_waypoints(waypoints(1.0, 2.0))
    writer.append(stamps[2:3], groundtruth[2:3], estimate[2:3], {"at": 3})
    zeros = np.hstack([estimate[3:4], np.zeros((1, 36))])
    writer.append(stamps[3:4], groundtruth[3:4], zeros)
    writer.append(stamps[4:], groundtruth[4:], wide[4:])
    writer.close()
    found = read_pairs(tmp_path / "x.pairs")
    assert found.covariances is not None
    expected = wide[:, 10:].copy()
    expected[2:4] = 0.0
    np.testing.assert_array_equal(found.covariances.reshape(6, 36), expected)
    np.testing.assert_array_equal(found.stamps, stamps)
    np.testing.assert_array_equal(found.groundtruth, groundtruth)
    np.testing.assert_array_equal(found.estimate, estimate)
    assert (found.pairs_at_state, found.state, found.torn) == (3, {"at": 3}, 0)
    np.testing.assert_array_equal(found.waypoints.stamps, waypoints(1.0, 2.0).stamps)
    np.testing.assert_array_equal(found.waypoints.poses, waypoints(1.0, 2.0).poses)
