"""Faults in what is published: each is counted, told, and equal to what offline makes of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from ros_bags import ODOM, POSE, Message, messages_of, odometry_message, write_messages
from ros_processes import Evaluator, Peer, assert_same, offline, play_without_loss
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

STEADY, RESTARTS, BACKWARDS, UNSET, TWICE, BROKEN = (
    f"/vio/{name}" for name in ("steady", "restarts", "backwards", "unset", "twice", "broken")
)
ESTIMATES = [STEADY, RESTARTS, BACKWARDS, UNSET, TWICE, BROKEN]
GOOD, LATE, HOLED = "/groundtruth/good", "/groundtruth/late", "/groundtruth/holed"
LATE_S, HOLE_S = 12.0, (15.0, 45.0)
STEP_BACK_S = 4.0
RESTARTED = "1 restart of the estimate"

Rows = tuple[list[int], NDArray[np.float64], NDArray[np.float64]]


def columns(source: Trajectory) -> Rows:
    """Return stamps, positions and quaternions that may be spoiled."""
    assert source.quaternions is not None
    return source.stamps.tolist(), source.positions.copy(), source.quaternions.copy()


def odometry(topic: str, log_times: list[int], rows: Rows) -> list[Message]:
    return [
        (topic, ODOM, log_time, odometry_message(stamp, place, rotation))
        for log_time, stamp, place, rotation in zip(log_times, *rows, strict=True)
    ]


def restarted(source: Trajectory) -> Trajectory:
    """Return an estimate that dies in the middle, and comes back at an origin of its own."""
    seconds = source.seconds
    after = source[seconds > 29.0]
    rotation = Rotation.from_euler("z", 100.0, degrees=True)
    assert after.rotations is not None
    positions = rotation.apply(after.positions - after.positions[0])
    before = source[seconds < 25.0]
    assert before.rotations is not None
    return Trajectory(
        np.concatenate([before.stamps, after.stamps]),
        np.concatenate([before.positions, positions]),
        Rotation.concatenate([before.rotations, rotation * after.rotations]).as_quat(),
    )


def estimates(source: Trajectory) -> list[Message]:
    """Return the messages of all estimates, each with its fault."""
    times, places, rotations = columns(source)
    rows = range(len(times))
    back = round(STEP_BACK_S * NANOSECONDS)
    shifted = [stamp - back * (row > len(times) // 2) for row, stamp in enumerate(times)]
    unset = [0 if row % 10 == 0 else stamp for row, stamp in enumerate(times)]
    broken_places, broken_turns = places.copy(), rotations.copy()
    broken_places[5::50, 1] = np.nan
    broken_places[7::100, 0] = np.inf
    broken_turns[15::50] = 0.0
    broken_turns[25::50, 2] = np.nan
    restart = columns(restarted(source))
    return [
        *odometry(STEADY, times, (times, places, rotations)),
        *odometry(RESTARTS, restart[0], restart),
        *odometry(BACKWARDS, times, (shifted, places, rotations)),
        *odometry(UNSET, times, (unset, places, rotations)),
        *odometry(TWICE, times, (times, places, rotations)),
        *odometry(TWICE, [times[row] + 1 for row in rows], (times, places + 5.0, rotations)),
        *odometry(BROKEN, times, (times, broken_places, broken_turns)),
    ]


def groundtruths(source: Trajectory) -> list[Message]:
    """Return the messages of a good groundtruth, a late one, and one with a hole and the rest."""
    seconds = source.seconds
    hole = (seconds > HOLE_S[0]) & (seconds < HOLE_S[1])
    holed = messages_of(source[~hole], HOLED, POSE)
    spoiled = messages_of(moved(source[~hole][10::100], np.nan), HOLED, POSE)
    twice = messages_of(moved(source[~hole][20::100], 3.0), HOLED, POSE)
    return [
        *messages_of(source, GOOD, POSE),
        *messages_of(source[seconds > LATE_S], LATE, POSE),
        *holed,
        *((topic, kind, time + 1, payload) for topic, kind, time, payload in spoiled + twice),
    ]


def moved(source: Trajectory, by_m: float) -> Trajectory:
    return Trajectory(source.stamps, source.positions + by_m, source.quaternions)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    simulated = simulate(5, 60.0)
    path = tmp_path_factory.mktemp("faulty") / "bag"
    groundtruth = simulated.groundtruth[::2]
    write_messages(path, [*groundtruths(groundtruth), *estimates(simulated.estimate)])
    return path


@pytest.fixture(scope="module")
def diagnostics() -> list[Any]:
    """The status messages of all evaluators."""
    return []


@pytest.fixture(scope="module")
def heard(
    bag: Path,
    peer: Peer,
    environment: dict[str, str],
    diagnostics: list[Any],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Evaluator]:
    """What evaluators made of it, with each of the groundtruths."""
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = peer.hear("/diagnostics", DiagnosticArray)
    # As the recorded topics are evaluated: sorted.
    common = {"gauge": "yaw", "lengths": "8,16", "on_time_jump": "ignore"}
    nodes = {
        "good": {**common, "groundtruth": GOOD, "estimates": ESTIMATES},
        "late": {**common, "groundtruth": LATE, "estimates": [STEADY]},
        "holed": {**common, "groundtruth": HOLED, "estimates": [STEADY]},
    }
    folder = tmp_path_factory.mktemp("heard")
    done = play_without_loss(bag, peer, environment, folder, nodes, rate=4.0)
    peer.until(lambda: jumped(statuses(arrays)) >= {"good: vio_restarts"}, "a jump is told")
    diagnostics += statuses(arrays)
    return done


def jumped(result: list[Any]) -> set[str]:
    """Return the names of the statuses that tell of one restart."""
    return {item.name for item in result if RESTARTED in item.message}


def statuses(arrays: list[Any]) -> list[Any]:
    return [status for array in arrays for status in array.status]


@pytest.fixture
def recorded(bag: Path, tmp_path: Path) -> Callable[[str, str], Any]:
    """Return what `trajeval evaluate` says of a groundtruth and an estimate."""

    def evaluate(groundtruth: str, estimate: str) -> Any:
        return offline(
            bag, tmp_path, groundtruth, [estimate], "--gauge", "yaw", "--lengths", "8,16"
        )

    return evaluate


@pytest.mark.parametrize("topic", [STEADY, RESTARTS, UNSET, TWICE, BROKEN])
def test_of_several_estimates_at_once_each_is_judged_as_offline(
    heard: dict[str, Evaluator], recorded: Callable[[str, str], Any], topic: str
) -> None:
    live, expected = heard["good"].run_of(topic), recorded(GOOD, topic)["runs"][0]
    assert_same(live, expected)
    assert heard["good"].result["failed"] == []


def test_a_restart_with_a_new_origin_is_told_wherever_it_matters(
    heard: dict[str, Evaluator], diagnostics: list[Any]
) -> None:
    run = heard["good"].run_of(RESTARTS)
    assert [event["kind"] for event in run["events"]] == ["restart"]
    assert heard["good"].printed.count("vio_restarts: the estimate restarted at its origin") == 1
    told = [diagnostic for diagnostic in diagnostics if RESTARTED in diagnostic.message]
    assert jumped(told) == {"good: vio_restarts"}
    assert b"\x00" not in {item.level for item in told}
    steady = heard["good"].run_of(STEADY)
    assert steady["events"] == []
    assert steady["ate"]["position_m"]["rmse"] < 0.3 * run["ate"]["position_m"]["rmse"]


def test_stamps_that_step_back_are_told_and_sorted(
    heard: dict[str, Evaluator], recorded: Callable[[str, str], Any]
) -> None:
    live, expected = heard["good"].run_of(BACKWARDS), recorded(GOOD, BACKWARDS)["runs"][0]
    assert any(
        "timestamps step back at" in item["text"] for item in expected["estimate"].pop("remarks")
    )
    assert any(
        "timestamps step back by 3.9 s" in item["text"] for item in live["estimate"].pop("remarks")
    )
    # Its size, and the onset of the divergence that it looks like, depend on the order of arrival.
    assert any(remark["code"] == "clock_step" for remark in live["remarks"])
    for run in (live, expected):
        del run["remarks"], run["diagnosis"]
    assert_same(live, expected)
    # Once in the log; the tables at the end have a note.
    assert heard["good"].printed.count(f"]: {BACKWARDS}: timestamps step back by 3.9 s") == 1


def test_what_is_no_pose_is_counted_by_reason(heard: dict[str, Evaluator]) -> None:
    poses = heard["good"].run_of(STEADY)["association"]["pairs"]

    def dropped(topic: str) -> Any:
        return heard["good"].run_of(topic)["association"]["dropped"]

    assert dropped(UNSET) == {"zero_stamp": -(-poses // 10)}
    assert dropped(TWICE) == {"duplicate_stamp": poses}
    assert dropped(BROKEN) == {
        "not_finite": len(range(5, poses, 50)) + len(range(7, poses, 100))
        + len(range(25, poses, 50)),
        "zero_quaternion": len(range(15, poses, 50)),
    }  # fmt: skip


@pytest.mark.parametrize(("name", "topic"), [("late", LATE), ("holed", HOLED)])
def test_what_the_groundtruth_does_not_cover_is_in_no_pair(
    heard: dict[str, Evaluator], recorded: Callable[[str, str], Any], name: str, topic: str
) -> None:
    assert_same(heard[name].result, recorded(topic, STEADY))


def test_groundtruth_is_never_made_up(heard: dict[str, Evaluator]) -> None:
    [late], [holed] = heard["late"].result["runs"], heard["holed"].result["runs"]
    assert 200 < late["association"]["dropped"]["before_groundtruth"] < 250
    assert 500 < holed["association"]["dropped"]["in_groundtruth_gap"] < 620
    assert any(
        "not finite" in remark["text"] and "duplicate" in remark["text"]
        for remark in holed["remarks"]
    )
    assert holed["ate"]["position_m"]["rmse"] < 1.0
