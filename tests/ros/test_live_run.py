"""A live run without a network: bytes in any batches, and what `finish` makes of them."""

from __future__ import annotations

import dataclasses
import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_runs import COUNT, ESTIMATE, GROUNDTRUTH, Live, batches, messages, path_messages
from ros_bags import ODOM, PATH, POSE, messages_of, write_messages
from ros_processes import assert_same, offline
from strategies import make_pair, seeds
from waiting import until

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.io.live import chunk_file
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.ros.output_folder import Finisher
from trajeval_ros.ros.recorded_state import why_no_pair, write_states


@pytest.mark.slow
@settings(max_examples=10)
@given(seed=seeds, cuts=st.lists(st.integers(0, COUNT), max_size=20), late=st.integers(0, 20))
def test_any_batches_of_bytes_give_the_offline_result(
    tmp_path_factory: pytest.TempPathFactory, seed: int, cuts: list[int], late: int
) -> None:
    folder = tmp_path_factory.mktemp("run")
    feed = messages(seed)
    write_messages(folder / "bag", feed)
    live = Live(folder / "live", ODOM)
    arriving = sorted(feed, key=lambda item: item[2] + (item[0] == ESTIMATE) * late * 10**8)
    for batch in batches(arriving, cuts):
        live.feed(batch)
    live.end()
    expected = offline(
        folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], "--gauge", "yaw", "--lengths", "2,4"
    )
    assert_same(live.result, expected)


def test_a_path_has_its_revised_error_and_the_causal_one_beside_it(tmp_path: Path) -> None:
    pair = make_pair(3, COUNT, smooth=True)
    drawn = path_messages(pair.estimate, 7)
    feed = sorted(
        [*messages_of(pair.groundtruth, GROUNDTRUTH, POSE), *drawn], key=lambda item: item[2]
    )
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", PATH)
    for message in feed:
        live.feed([message])
    live.end()
    options = ("--gauge", "yaw", "--lengths", "2,4")
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *options)
    [run], [recorded] = live.result["runs"], expected["runs"]
    assert_same(run["ate"], recorded["ate"])
    assert_same(run["re"], recorded["re"])
    causal = run["live"]["causal_ate"]["position_m"]
    assert causal["rmse"] > 1.5 * run["ate"]["position_m"]["rmse"]


def test_a_run_that_goes_on_is_evaluated_so_far(tmp_path: Path) -> None:
    feed = messages(5)
    live = Live(tmp_path / "live", ODOM)
    counts = []
    for batch in batches(feed, [60, 120, 180]):
        live.feed(batch)
        write_states(live.run)
        [run] = live.result["runs"]
        counts.append(run["association"]["pairs"])
        assert run["remarks"] == []
    assert counts == sorted(set(counts))
    live.feed([])  # nothing new
    live.end()
    assert live.result["runs"][0]["association"]["pairs"] >= counts[-1]


@pytest.mark.slow
@pytest.mark.parametrize("verb", [["info"], []])
def test_its_folder_is_for_finish(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    live = Live(tmp_path / "live", ODOM)
    live.feed(messages(7))
    live.end()
    assert main([*verb, str(live.folder)]) == 2
    advice = capsys.readouterr().err.rpartition("evaluate it: trajeval ")[2]
    assert main([*advice.split(), "--quiet"]) == 0


def test_after_a_crash_the_pairs_count_and_the_missing_counts_are_told(tmp_path: Path) -> None:
    feed = messages(6)
    live = Live(tmp_path / "live", ODOM)
    before, after = feed[:120], feed[120:]
    live.feed(before)
    write_states(live.run)
    live.feed(after)  # and here it crashes
    [run] = live.result["runs"]
    assert run["association"]["pairs"] == live.run.estimates[0].evaluator.pairs
    [told] = [
        remark["text"]
        for remark in run["remarks"]
        if "stopped before its last counts" in remark["text"]
    ]
    later = sum(topic == ESTIMATE for topic, *_ in after)
    assert f"{later} poses before the end" in told
    with (live.folder / "vio.states").open("r+b") as file:
        file.truncate(file.seek(0, 2) - 5)
    [torn] = live.result["runs"]
    assert 0 < torn["association"]["pairs"] < run["association"]["pairs"]


def test_pairs_that_a_disk_did_not_take_are_missing_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    live = Live(tmp_path / "live", ODOM)
    first, rest = messages(6)[:120], messages(6)[120:]
    with monkeypatch.context() as patch:
        patch.setattr(chunk_file, "_MOST_WAITING", 2000)
        patch.setattr("os.write", full)
        for batch in batches(first, range(5, 120, 5)):
            live.feed(batch)
    live.feed(rest)
    live.end()
    [run] = live.result["runs"]
    told = [
        remark["text"] for remark in run["remarks"] if "missing, since the disk" in remark["text"]
    ]
    assert told
    for item in told:
        assert item.endswith("since the disk could not be written: no space left on device")


def full(*_: object) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_an_estimate_that_fails_is_named_beside_those_that_did_not(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    live.feed(messages(7))
    live.end()
    (live.folder / "broken.states").write_bytes(b"no states")
    result = live.result
    [failed] = result["failed"]
    assert failed["name"] == "broken"
    assert "is not a file of states" in failed["reason"]
    assert [run["estimate"]["name"] for run in result["runs"]] == ["vio"]


@pytest.mark.parametrize(
    ("prepare", "complaint"),
    [
        (lambda folder: None, "no live run in"),
        (
            lambda folder: (folder / "a.states").write_bytes(b"x"),
            "groundtruth.states can't be read",
        ),
        (lambda folder: Live(folder / "sub", ODOM).end(), "no live run in"),
        (lambda folder: folder.rmdir(), "no live run in"),
    ],
    ids=["empty", "no states", "below", "missing"],
)
def test_a_folder_without_a_run_is_one_sentence(
    tmp_path: Path, prepare: Any, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    prepare(folder)
    assert main(["finish", str(folder)]) == 2
    text = capsys.readouterr()
    assert text.out == ""
    assert text.err.count("\n") <= 3
    assert complaint in " ".join(text.err.split())


def test_poses_without_stamps_are_told(tmp_path: Path) -> None:
    pair = make_pair(8, COUNT, smooth=True)
    count = len(pair.estimate)
    undated = dataclasses.replace(pair.estimate, stamps=np.zeros(count, np.int64))
    live = Live(tmp_path / "live", ODOM)
    live.feed(messages_of(pair.groundtruth, GROUNDTRUTH, POSE))
    feed = messages_of(undated, ESTIMATE, ODOM)
    stream = live.estimate.stream
    live.feed(feed[:9])
    assert stream.trouble is None
    live.feed(feed[9:10])
    assert stream.trouble.text == "/vio: no message with a valid pose (with timestamp zero)"
    live.feed(feed[10:])
    assert [item.text for item in stream.news] == [
        "/vio: no message with a valid pose (with timestamp zero)"
    ]
    assert why_no_pair(live.run).endswith(
        f"{len(pair.groundtruth)} poses on /groundtruth, 0 poses on /vio "
        f"({count} with timestamp zero)"
    )
    live.feed(messages_of(pair.estimate, ESTIMATE, ODOM))
    assert stream.trouble is None
    live.feed(feed[:1])  # one of them among others
    assert stream.trouble is None
    live.end()


@pytest.mark.parametrize("waits", [True, False])
def test_what_is_being_written_is_given_up_when_all_is_to_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, waits: bool
) -> None:
    program, folder = tmp_path / "program", tmp_path / "out"
    folder.mkdir()
    program.write_text(
        '#!/bin/sh\ncase "$*" in *--json*)\n'
        f'touch "{folder}/.result.json.trajeval-01234567" "{folder}/.other.json.1.part"\n'
        "exec sleep 600;; esac\necho trajeval: full >&2\nexit 2\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(program))
    finisher = Finisher(folder)
    finisher.save()
    until(lambda: len(list(folder.iterdir())) == 2, "it writes")
    if waits:
        assert not finisher.finish(quiet=True)
    else:
        finisher.finish_alone()
        assert finisher.is_busy
        until(finisher.poll, "all is written, or not")
    assert [path.name for path in folder.iterdir()] == [".other.json.1.part"]
    assert finisher.trouble == "full"


def test_the_evaluation_of_a_long_run_continues_after_the_end_of_the_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy", reason="`make test-ros` has it", exc_type=ImportError)
    from trajeval_ros.ros import result_writing

    pair, log = make_pair(3, COUNT, smooth=True), []
    live = Live(tmp_path / "live", ODOM)
    live.feed(messages_of(pair.groundtruth, GROUNDTRUTH, POSE))
    live.feed(messages_of(pair.estimate, ESTIMATE, ODOM))
    run = live.run
    write_states(run)
    run.close()
    monkeypatch.setattr(result_writing, "MOST_AWAITED", run.pair_count - 1)
    writing = result_writing.ResultWriting(lambda: run, lambda text, _: log.append(text))
    assert writing.conclude(run)
    assert run.finisher.is_busy
    [message] = log
    assert f"trajeval finish {run.folder}" in message
    until(run.finisher.poll, "the process ends")
    assert not run.finisher.trouble
    assert {"result.json", "errors.npz"} <= {file.name for file in run.folder.iterdir()}


def test_an_autosave_that_is_late_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="`make test-ros` has it", exc_type=ImportError)
    from trajeval_ros.ros.result_writing import ResultWriting

    live = Live(tmp_path / "live", ODOM)
    live.feed(messages(6))
    run, now = live.run, [100.0]
    monkeypatch.setattr("trajeval_ros.ros.output_folder.time.monotonic", lambda: now[0])
    monkeypatch.setattr("sys.executable", "true")
    took_s, written, told = 1.0, [], []
    writing = ResultWriting(lambda: run, lambda text, _: told.append(text))
    for _ in range(400):
        now[0] += 1.0
        writing.report(30.0)
        if run.finisher.is_busy:
            written.append(now[0])
            now[0] += took_s
            until(run.finisher.poll, "it is written")
            took_s *= 2.0
    # Evaluations of 1, 2, 4 and 8 s, and 5 % of a core.
    assert np.diff(written)[:3] == pytest.approx([30.0, 40.0, 80.0], abs=6.0)
    assert [item.partition(" instead of 30 s")[0] for item in told] == [
        "result.json is written every 40 s",
        "result.json is written every 80 s",
        "result.json is written every 160 s",
        "result.json is written every 320 s",
    ]
    live.end()


def test_a_run_without_pairs_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    live = Live(tmp_path / "live", ODOM)
    live.feed([message for message in messages(8) if message[0] == GROUNDTRUTH])
    live.end()
    assert live.finish() == 2
    assert "/vio: no usable pose in vio" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_finish_holds_a_run_against_bounds(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    live.feed(messages(9))
    live.end()
    assert live.finish("--require", "ate.position_m.rmse<100") == 0
    assert live.finish("--require", "ate.position_m.rmse<1e-9") == 1
    assert live.finish("--output", str(tmp_path / "out")) == 0
    picture = live.folder / "run.rrd"  # which the node draws, and nothing draws again
    picture.touch()
    assert live.finish("--output", str(live.folder)) == 0
    assert picture.exists()
    assert {"result.json", "errors.npz"} <= {path.name for path in (tmp_path / "out").iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", [ODOM, PATH])
def test_keyframes_cover_what_they_cover_in_a_bag(tmp_path: Path, kind: str) -> None:
    flown = simulate(seed=4, duration_s=60.0).groundtruth
    groundtruth, start = flown[::5], int(flown.stamps[0])
    steps = np.tile([6, 6, 6, 24], 60)  # twentieths of a second
    frames = flown[3::10]
    kept = frames[np.cumsum(steps)[np.cumsum(steps) < len(frames)]]
    after_s = (kept.stamps - start) / 1e9
    kept = kept[(after_s < 20.0) | (after_s > 32.0)]
    if kind == ODOM:
        drawn = messages_of(kept, ESTIMATE, kind)
    else:
        # The last version has fewer keyframes than were ever published.
        culled = kept[np.arange(len(kept)) % 5 != 2]
        drawn = [*path_messages(kept, 7)[:-1], path_messages(culled, len(culled))[0]]
        drawn[-1] = (*drawn[-1][:2], int(kept.stamps[-1]), drawn[-1][3])
    feed = sorted(
        [*messages_of(groundtruth, GROUNDTRUTH, POSE), *drawn], key=lambda message: message[2]
    )
    write_messages(tmp_path / "bag", feed)
    # A path with several new poses comes after a loss that is longer than groundtruth is held.
    live = Live(tmp_path / "live", kind, limits=BufferLimits(past_s=60.0))
    for batch in batches(feed, range(0, len(feed), 50)):
        live.feed(batch)
    live.end()
    options = ("--gauge", "yaw", "--lengths", "2,4")
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *options)
    [run], [recorded] = live.result["runs"], expected["runs"]
    assert recorded["association"]["keyframes"]
    assert recorded["association"]["longest_gap"]["duration_s"] > 12.0
    assert recorded["association"]["longest_gap"]["reach_m"] > 1.0
    names = ("groundtruth_coverage", "groundtruth_span", "keyframes", "longest_gap")
    for name in names:
        assert_same(run["association"][name], recorded["association"][name])
