"""The newest messages of a run, from which the next run begins."""

from __future__ import annotations

import numpy as np
from state_rows import states, trajectory

from trajeval_ros.ros.message_tail import DecodedMessages, MessageTail

SECOND = 10**9


def block(*seconds: float, is_path: bool = False, resets: tuple[int, ...] = ()) -> DecodedMessages:
    stamps = np.round(np.array(seconds) * SECOND).astype(np.int64)
    poses = trajectory(stamps, states(np.zeros((len(stamps), 3))))
    times = stamps[:1] if is_path else stamps
    return DecodedMessages(poses, times, is_path=is_path, resets=resets)


def seconds_of(tail: MessageTail) -> list[tuple[int, list[float]]]:
    return [(source, (item.states.stamps / SECOND).tolist()) for source, item in tail]


def test_old_messages_are_forgotten_by_source() -> None:
    """The clocks of two sources may differ by years, and one of them may be silent."""
    tail = MessageTail()
    tail.add(0, block(1.0, 2.0))
    for second in range(100):
        tail.add(1, block(1e9 + second))
        tail.forget(2.0)
    assert seconds_of(tail) == [(0, [1.0, 2.0]), *((1, [1e9 + s]) for s in (97, 98, 99))]
    assert tail.first(1) == round(1e9 + 97) * SECOND
    assert tail.first(2) is None


def test_messages_are_as_old_as_the_newest_of_their_block() -> None:
    tail = MessageTail()
    for seconds in ((1.0, 8.5), (9.0,), (10.0,)):
        tail.add(1, block(*seconds))
    tail.forget(2.0)
    assert seconds_of(tail) == [(1, [1.0, 8.5]), (1, [9.0]), (1, [10.0])]


def test_a_step_back_of_time_forgets_what_came_before() -> None:
    tail = MessageTail()
    for second in (50.0, 51.0, 3.0, 4.0):
        tail.add(1, block(second))
        tail.forget(10.0)
    assert seconds_of(tail) == [(1, [3.0]), (1, [4.0])]


def test_messages_since_a_time_are_in_order_of_arrival() -> None:
    tail = MessageTail()
    tail.add(0, block(1.0, 2.0))
    tail.add(1, block(1.5, 2.5))
    tail.add(0, block(3.0, 4.0))
    tail.add(2, block(9.0))
    begins = {0: round(2.7 * SECOND), 1: round(2.5 * SECOND)}

    def since(before: set[int]) -> list[tuple[int, list[float]]]:
        result = tail.since(begins, before)
        return [(source, (item.times / SECOND).tolist()) for source, item in result]

    assert since(set()) == [(1, [2.5]), (0, [3.0, 4.0])]
    assert since({0}) == [(0, [2.0]), (1, [2.5]), (0, [3.0, 4.0])]
    assert since({1}) == since(set())  # a state at the time itself


def test_of_a_path_the_newest_version_is_kept() -> None:
    tail = MessageTail()
    tail.add(1, block(1.0, 2.0, is_path=True))
    tail.add(1, block(1.0, 2.0, 3.0, is_path=True))
    [(_, kept)] = tail.since({1: 2 * SECOND}, set())
    assert (kept.states.stamps / SECOND).tolist() == [2.0, 3.0]
    assert kept.stamps.tolist() == [3 * SECOND]
    assert kept.is_path


def test_resets_stay_with_their_poses() -> None:
    messages = block(1.0, 2.0, 3.0, resets=(1 * SECOND, 3 * SECOND))
    assert messages.part(slice(2)).resets == (1 * SECOND,)
    assert messages.part(slice(1, None)).resets == (3 * SECOND,)
    assert messages.part(slice(None)).resets == messages.resets
