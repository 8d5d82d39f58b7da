"""Paths and streams of the viewer: pieces, thinning, memory, and a slow receiver."""

from __future__ import annotations

import threading
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import PATIENCE_S, until

from trajeval_ros.viewer import appearance, colours, entity_data, live_path, scene_entities
from trajeval_ros.viewer.live_path import LivePath, RowHistory, Thinning
from trajeval_ros.viewer.paths import pieces
from trajeval_ros.viewer.stream import DrawingThread


@given(
    st.integers(0, 60),
    st.lists(st.integers(0, 58), max_size=5),
    st.integers(1, 70),
)
def test_pieces_draw_every_step_once_but_the_gaps(count: int, cuts: list[int], most: int) -> None:
    is_gap = np.zeros(max(count - 1, 0), dtype=bool)
    is_gap[[cut for cut in cuts if cut < len(is_gap)]] = True
    rows = pieces(count, is_gap, most)
    assert len(rows) <= most
    steps = [(a, b) for piece in rows.tolist() for a, b in pairwise(piece) if a != b]
    assert len(steps) == len(set(steps))
    assert all(b == a + 1 and not is_gap[a] for a, b in steps)
    if rows.shape[1] == 2:
        assert {a for a, _ in steps} == set(np.flatnonzero(~is_gap).tolist())


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=50))
def test_scale_of_colours_is_round_and_holds_nearly_all(errors: list[float]) -> None:
    full_m = colours.scale_for(np.array(errors))
    most = float(np.percentile(errors, 98))
    assert full_m >= 0.998 * most
    assert full_m <= max(2.0 * most, 1e-3) * 1.001
    assert float(f"{full_m:.0e}") == pytest.approx(full_m)


@pytest.mark.parametrize(
    ("error_m", "full_m"),
    [
        (0.0, 1e-3), (1e-6, 1e-3), (2e-6, 2e-6), (0.01, 0.01), (0.0701, 0.1), (1.0005, 1.0),
        (1.1, 2.0), (2.1, 3.0), (3.1, 5.0), (49.0, 50.0), (99.0, 100.0),
    ],
)  # fmt: skip
def test_scale_of_colours_is_the_next_round_number(error_m: float, full_m: float) -> None:
    assert colours.scale_for(np.array([error_m])) == pytest.approx(full_m)


@pytest.mark.slow
@given(st.lists(st.integers(1, 30_000_000_000), min_size=1, max_size=80), st.integers(1, 7))
def test_thinning_takes_one_pose_of_each_slot_in_any_batches(steps: list[int], size: int) -> None:
    stamps = np.cumsum(np.array(steps, dtype=np.int64) // 100)
    thinning = Thinning()
    picked = np.concatenate(
        [
            stamps[begin : begin + size][thinning.pick(stamps[begin : begin + size])]
            for begin in range(0, len(stamps), size)
        ]
    )
    slots = stamps // live_path.DRAWN_EVERY_NS
    assert picked.tolist() == stamps[np.unique(slots, return_index=True)[1]].tolist()


class DrawnPath:
    """A live path, and the rows that it has drawn."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        class Strips(list):
            def row(self) -> list[np.ndarray]:
                return [np.asarray(item) for item in self]

        monkeypatch.setattr(entity_data, "lines", lambda strips, look=None: Strips(strips))
        self.rows: list[tuple[int, str, list[np.ndarray]]] = []
        self.entities = scene_entities.PathEntities.below("world/x")
        self.path = LivePath(
            self.entities, lambda *row: self.rows.append(row), appearance.GROUNDTRUTH_PATH
        )

    def shown(self, now: int) -> list[np.ndarray]:
        """Return the strips in sight at a time."""
        newest = {entity: strips for stamp, entity, strips in self.rows if stamp <= now}
        return [strip for strips in newest.values() for strip in strips]


def is_of(strips: list[np.ndarray], points: np.ndarray) -> bool:
    """Return whether strips have all these points and no others."""
    return {tuple(point) for strip in strips for point in strip} == {*map(tuple, points)}


@pytest.mark.parametrize("piece", [3, 200])
def test_growing_path_is_whole_at_every_time(piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_path, "_PIECE", piece)
    drawn = DrawnPath(monkeypatch)
    points = np.random.default_rng(0).normal(size=(1000, 3))
    stamps = np.arange(1000) * 100_000_000
    stamps[600:] += 5_000_000_000
    told = []
    for stamp, point in zip(stamps.tolist(), points, strict=True):
        told.append(drawn.path.add(stamp, point))
        drawn.path.draw_to(stamp, point)
    assert [gap for gap in told if gap] == [5_100_000_000]
    for now in (0, 1, 19, 20, 21, 199, 200, 201, 599, 600, 601, 999):
        shown = drawn.shown(int(stamps[now]))
        assert is_of(shown, points[: now + 1])
        for strip in shown:
            ends = [np.flatnonzero((points == item).all(axis=1))[0] for item in strip]
            assert not (min(ends) < 600 <= max(ends))
    # Another recording has the same.
    drawn.rows.clear()
    drawn.path.draw_again()
    assert is_of(drawn.shown(int(stamps[-1])), points)


@pytest.mark.slow
def test_a_path_of_days_is_drawn_with_few_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_path, "_PIECE", 10)
    drawn = DrawnPath(monkeypatch)
    points = np.random.default_rng(0).normal(size=(100_000, 3))
    for row, point in enumerate(points):
        drawn.path.add(row * 100_000_000, point)
    shown = drawn.shown(100_000 * 100_000_000)
    assert sum(map(len, shown)) < 40_000
    assert max(map(len, shown)) <= 2 * 10 + 1
    # The newest poses are all there, and the first pose, and no line leads past a dropped piece.
    assert {*map(tuple, points[-500:-20])} <= {tuple(item) for strip in shown for item in strip}
    ends = {tuple(strip[0]) for strip in shown} ^ {tuple(strip[-1]) for strip in shown}
    assert tuple(points[0]) in ends
    assert len(ends) <= 4
    sent = sum(len(strip) for _, entity, strips in drawn.rows for strip in strips)
    assert sent < 20 * len(points)


def test_memory_keeps_the_run_and_its_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_path, "_MOST_ROWS", 100)
    memory = RowHistory(1)
    for index in range(12_345):
        memory.add(index, np.array([float(index)]))
    stamps, rows = memory.columns()
    assert 50 <= len(stamps) <= 100
    assert (np.diff(stamps) > 0).all()
    assert (rows[:, 0] == stamps).all()
    assert stamps[0] < 300 < 12_000 < stamps[-1]
    assert np.diff(stamps).max() <= 2 * np.diff(stamps).min()  # old and new rows are as dense


class Slow:
    """A sink, and what draws on it, which a test holds up."""

    name, absence, check_every_s, blueprint = "slow", "", 0.05, None

    def __init__(self) -> None:
        self.free = threading.Event()
        self.told: list[int] = []

    def open(self, blueprint: object) -> object:
        del blueprint
        return self

    def check(self, recording: object) -> bool:
        del recording
        return True

    def close(self, recording: object) -> None:
        del recording

    def begin(self, recording: object) -> None:
        del recording

    def leave(self) -> None:
        pass

    def finish(self) -> None:
        pass

    def disconnect(self) -> None:
        pass

    def dropped(self, count: int) -> None:
        self.told.append(count)


def test_who_hands_over_never_waits_and_drops_are_counted_and_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sink, drawn = Slow(), []
    stream = DrawingThread(sink, sink)
    stream.put(lambda: sink.free.wait(PATIENCE_S))
    for index in range(5000):
        stream.put(lambda index=index: drawn.append(index))
    assert stream.dropped > 2000
    monkeypatch.setattr("trajeval_ros.viewer.stream._PATIENCE_S", 0.2)
    assert not stream.close()
    sink.free.set()
    monkeypatch.setattr("trajeval_ros.viewer.stream._PATIENCE_S", PATIENCE_S)
    assert stream.close()
    assert len(drawn) == 5000 - stream.dropped
    assert drawn == list(range(len(drawn)))
    assert sink.told[-1:] in ([], [stream.dropped])


def test_drops_are_told_while_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trajeval_ros.viewer.stream._PATIENCE_S", PATIENCE_S)
    sink = Slow()
    stream = DrawingThread(sink, sink)
    stream.put(lambda: sink.free.wait(PATIENCE_S))
    for _ in range(3000):
        stream.put(lambda: None)
    sink.free.set()
    until(lambda: sink.told, "drops are told")
    assert sink.told == [stream.dropped]
    assert stream.close()


def test_a_sparse_stream_is_a_line_and_not_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entity_data, "lines", lambda *_: SimpleNamespace(row=list))
    path = LivePath(
        scene_entities.PathEntities.below("world/x"),
        lambda *_: None,
        appearance.GROUNDTRUTH_PATH,
    )
    seconds = [*np.arange(0.0, 20.0), *np.arange(40.0, 60.0), *np.arange(60.0, 70.0, 0.1)]
    seconds += [*np.arange(70.0, 90.0)]
    gaps_s = [path.add(round(1e9 * second), np.zeros(3)) / 1e9 for second in seconds]
    told = {round(at, 1): gap for at, gap in zip(seconds, gaps_s, strict=True) if gap}
    # Fixes once a second have one gap. Where a faster stream becomes so sparse, it soon is a line.
    assert told[40.0] == 21.0
    assert all(gap == 1.0 for at, gap in told.items() if at >= 70.0)
    assert len(told) <= 4
