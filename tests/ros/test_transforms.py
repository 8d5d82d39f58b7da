"""Live transforms over DDS: the evaluator on `/tf` gives what `trajeval evaluate` gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marker_flights import MOUNTED, of_marker
from recorded_runs import pairs_of
from ros_bags import (
    ODOM,
    POSE,
    TRANSFORMS,
    Message,
    messages_of,
    transforms_message,
    write_messages,
)
from ros_processes import (
    GROUNDTRUTH,
    ODOMETRY,
    Evaluator,
    Peer,
    assert_same,
    evaluating,
    offline,
    parameters,
    replay,
    run_evaluator,
)

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.ros.message_types import is_installed
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
# Beside the tests there is a folder of the same name, which alone can be imported, too.
if not is_installed(TRANSFORMS):
    pytest.skip(
        "tf2_msgs is missing; `make test-ros` builds it where there are a compiler and cmake",
        allow_module_level=True,
    )
pytestmark = pytest.mark.ros

ESTIMATE, MARKER = "/tf:map.camera", "/tf:world.marker"
SECOND = 10**9


def edge(parent: str, child: str, poses: Trajectory, topic: str = "/tf") -> list[Message]:
    """Return a trajectory as transforms, logged at their stamps."""
    assert poses.quaternions is not None
    rows = zip(poses.stamps.tolist(), poses.positions, poses.quaternions, strict=True)
    return [
        (topic, TRANSFORMS, stamp, transforms_message((parent, child, stamp, place, rotation)))
        for stamp, place, rotation in rows
    ]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a groundtruth, and of an estimate that three publishers make the tree of."""
    simulated = simulate(5, 25.0)
    groundtruth, estimate = simulated.groundtruth[::4], simulated.estimate
    begin = int(min(groundtruth.stamps[0], estimate.stamps[0]))
    random = np.random.default_rng(5)
    corrections = estimate[::4]
    drift = np.cumsum(random.normal(scale=0.01, size=(len(corrections), 3)), axis=0)
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(corrections), 1))
    corrections = Trajectory.from_columns(corrections.stamps + SECOND // 200, drift, still)
    mounted = transforms_message(("base", "camera", 0, (0.1, 0.0, 0.05), (0.5, -0.5, 0.5, 0.5)))
    bag = tmp_path_factory.mktemp("flight") / "bag"
    write_messages(
        bag,
        [
            *messages_of(groundtruth, GROUNDTRUTH, POSE),
            *edge("world", "marker", groundtruth),
            *edge("map", "odom", corrections),
            *edge("odom", "base", estimate),
            ("/tf_static", TRANSFORMS, begin, mounted),
        ],
    )
    return bag


def stamp_ns(transform: Any) -> int:
    return int(transform.header.stamp.sec) * SECOND + int(transform.header.stamp.nanosec)


def evaluate_live(
    bag: Path,
    environment: dict[str, str],
    folder: Path,
    groundtruth: str,
    estimate: str = ESTIMATE,
    static: tuple[str, ...] = ("/tf_static",),
    **values: object,
) -> Evaluator:
    """Evaluate a bag that another process plays; slower where a machine is too busy."""
    rate = 8.0
    while True:
        with evaluating(
            folder / f"rate_{rate:g}",
            environment,
            groundtruth=groundtruth,
            estimates=[estimate],
            gauge="yaw",
            lengths="4,8",
            window="0",
            **values,
        ) as evaluator:
            sources = {item.partition(":")[0] for item in (groundtruth, estimate)}
            played = {*sources, *static}
            topics = [word for topic in played for word in ("--topic", topic)]
            replay(bag, environment, "--rate", rate, *topics)
            assert evaluator.end() == 0
        live = evaluator.run_of(estimate)["live"]
        if not live["messages_lost"] + live["groundtruth_messages_lost"]:
            return evaluator
        assert rate > 1.0, f"messages are lost at rate {rate:g}"
        rate /= 3.0


@pytest.mark.parametrize("groundtruth", [GROUNDTRUTH, MARKER])
def test_live_is_offline(
    flight: Path, groundtruth: str, environment: dict[str, str], tmp_path: Path
) -> None:
    evaluator = evaluate_live(flight, environment, tmp_path, groundtruth)
    recorded = offline(
        flight, tmp_path, groundtruth, [ESTIMATE], "--gauge", "yaw", "--lengths", "4,8"
    )
    assert recorded["runs"][0]["association"]["pairs"] > 350
    assert_same(evaluator.result, recorded)


def test_a_marker_is_brought_to_the_body_by_static_transforms(
    environment: dict[str, str], tmp_path: Path
) -> None:
    bag, flight = tmp_path / "bag", simulate(5, 25.0)
    inner = ("base_link", "mount", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    outer = ("mount", "marker", 0, MOUNTED.lever_m, MOUNTED.rotation_xyzw)
    begin = int(flight.estimate.stamps[0])
    write_messages(
        bag,
        [
            *messages_of(of_marker(flight.groundtruth[::4]), GROUNDTRUTH, POSE),
            *messages_of(flight.estimate, ODOMETRY, ODOM),
            ("/tf_static", TRANSFORMS, begin, transforms_message(inner)),
            ("/tf_static", TRANSFORMS, begin, transforms_message(outer)),
        ],
    )
    frames = "/tf_static:base_link.marker"
    evaluator = evaluate_live(
        bag, environment, tmp_path, GROUNDTRUTH, ODOMETRY, hand_eye=frames, publish_rate=50.0
    )
    source = f"{bag}:{frames}"
    recorded = offline(
        bag,
        tmp_path,
        GROUNDTRUTH,
        [ODOMETRY],
        "--gauge",
        "yaw",
        "--lengths",
        "4,8",
        "--hand-eye",
        source,
    )
    [run] = recorded["runs"]
    assert run["calibration"]["ate"]["before"]["rotation_deg"] > 80.0
    assert run["ate"]["rotation_deg"]["rmse"] < 10.0
    run["calibration"]["ate"]["before"] = None  # live, nobody pairs a marker with the body
    run["calibration"]["hand_eye"]["source"] = frames
    assert_same(evaluator.result, recorded)


def test_the_alignment_is_broadcast_where_it_is_asked_for(
    flights: Path, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_srvs.srv import Trigger
    from tf2_msgs.msg import TFMessage

    heard = peer.hear("/tf", TFMessage)
    options = {"broadcast_tf": True, "transform_tolerance": 0.3, "gauge": "yaw"}
    with evaluating(tmp_path / "out", environment, **options) as evaluator:
        # It answers this node first, so it knows who listens; a transform is not repeated.
        peer.play(flights / "mcap", {GROUNDTRUTH: 1, ODOMETRY: 1}, ["evaluator"], rate=8.0)

        def is_of_last_pair() -> bool:  # which may still be on its way at the first save
            assert peer.ask("/evaluator/save", Trigger).success
            last_ns = int(pairs_of(evaluator.folder, "vio_odometry").estimate.stamps[-1])
            return bool(heard) and stamp_ns(heard[-1].transforms[0]) == last_ns + 300_000_000

        peer.until(is_of_last_pair, "the transform of the last pair is broadcast")
        assert len(heard) > 1
        assert evaluator.end() == 0
    [transform] = heard[-1].transforms
    result = evaluator.result
    assert transform.header.frame_id == result["groundtruth"]["frame"]
    assert transform.child_frame_id == result["runs"][0]["estimate"]["frame"]
    moved, alignment = transform.transform.translation, result["runs"][0]["alignment"]
    assert [moved.x, moved.y, moved.z] == pytest.approx(alignment["translation_m"], abs=0.1)
    rotated = transform.transform.rotation
    quaternion = np.array([rotated.x, rotated.y, rotated.z, rotated.w])
    assert abs(quaternion @ alignment["rotation_xyzw"]) == pytest.approx(1.0, abs=1e-3)


def test_static_transforms_may_be_beside_or_outside_a_namespace(
    environment: dict[str, str], tmp_path: Path
) -> None:
    source, bag = simulate(7, 20.0), tmp_path / "bag"
    groundtruth, begin = source.groundtruth[::4], int(source.groundtruth.stamps[0])
    straight = (0.0, 0.0, 0.0, 1.0)
    inner = transforms_message(("base", "mount", 0, (0.1, 0.0, 0.05), (0.5, -0.5, 0.5, 0.5)))
    outer = transforms_message(("mount", "camera", 0, (0.0, 0.2, 0.0), straight))
    write_messages(
        bag,
        [
            *messages_of(groundtruth, GROUNDTRUTH, POSE),
            *edge("map", "base", source.estimate, "/robot/tf"),
            ("/robot/tf_static", TRANSFORMS, begin, inner),
            ("/tf_static", TRANSFORMS, begin, outer),
        ],
    )
    estimate = "/robot/tf:map.camera"
    static = ("/robot/tf_static", "/tf_static")
    evaluator = evaluate_live(bag, environment, tmp_path, GROUNDTRUTH, estimate, static)
    options = ["--gauge", "yaw", "--lengths", "4,8"]
    recorded = offline(bag, tmp_path, GROUNDTRUTH, [estimate], *options)
    assert recorded["runs"][0]["association"]["pairs"] > 300
    assert_same(evaluator.result, recorded)


def test_a_latched_static_transform_is_received_beside_one_that_is_not_latched(
    flight: Path, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from rclpy.serialization import deserialize_message
    from tf2_msgs.msg import TFMessage

    mounted = transforms_message(("base", "camera", 0, (0.1, 0.0, 0.05), (0.5, -0.5, 0.5, 0.5)))
    publishers = [peer.publisher("/tf_static", TFMessage, latched=item) for item in (True, False)]
    publishers[0].publish(deserialize_message(mounted, TFMessage))
    with evaluating(
        tmp_path / "out", environment, estimates=[ESTIMATE], gauge="yaw", lengths="none"
    ) as evaluator:
        peer.until(publishers[0].get_subscription_count, "a reader of latched static transforms")
        replay(flight, environment, "--rate", 8, "--topic", GROUNDTRUTH, "--topic", "/tf")
        assert evaluator.end() == 0
    for publisher in publishers:
        peer.node.destroy_publisher(publisher)
    assert evaluator.run_of(ESTIMATE)["association"]["pairs"] > 300


def test_a_frame_that_is_not_there_is_named(
    flight: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    wrong = "/tf:map.camra"
    with evaluating(tmp_path / "out", environment, estimates=[wrong]) as evaluator:
        replay(flight, environment, "--rate", 8)
        evaluator.wait_for(f"{wrong}: unknown frame camra; use one of camera, ")
        evaluator.end()
    assert f"0 poses on {wrong}" in evaluator.printed


@pytest.mark.parametrize("source", ["/tf:map", "/tf:.camera", "/tf:map.map"])
def test_transforms_need_two_frames(source: str, environment: dict[str, str]) -> None:
    done = run_evaluator(
        environment, *parameters(groundtruth_topic=GROUNDTRUTH, estimate_topics=[source])
    )
    assert done.returncode == 2
    assert f"'{source}' has no pair of frames; write it as in /tf:map.base_link" in done.stderr


def test_transforms_need_tf2_msgs(environment: dict[str, str], tmp_path: Path) -> None:
    hidden = tmp_path / "tf2_msgs"
    hidden.mkdir()
    (hidden / "__init__.py").write_text("raise ImportError\n")
    without = {**environment, "PYTHONPATH": f"{tmp_path}:{environment['PYTHONPATH']}"}
    done = run_evaluator(
        without, *parameters(groundtruth_topic=GROUNDTRUTH, estimate_topics=[ESTIMATE])
    )
    assert done.returncode == 2
    assert f"{ESTIMATE} needs tf2_msgs; install" in done.stderr
