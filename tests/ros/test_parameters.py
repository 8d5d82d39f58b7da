"""Wrong parameters are one sentence, odd ones are understood, and folders are left alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ros_processes import Peer, evaluating, parameters, run_evaluator

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

TOPICS: dict[str, Any] = {"groundtruth_topic": "/groundtruth", "estimate_topics": ["/vio"]}


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"gauge": "yawn"}, "yawn"),
        ({"align_with": "pose"}, "did you mean poses?"),
        (
            {"window": "abc"},
            "the window 'abc' is not valid; give 0 (whole run), 30s, 50m or 500 (pairs)",
        ),
        ({"association": "nearest"}, "use one of auto, linear, groundtruth-stamps"),
        ({"max_gap": "wide"}, "parameter max_gap must be a number, not 'wide'"),
        ({"time_offset": "soon"}, "time_offset must be a number of seconds or auto, not 'soon'"),
        ({"groundtruth_topic": ""}, "groundtruth_topic and estimate_topics are required"),
        ({"estimate_topics": ["/vio", "/vio"]}, "/vio is given twice as an estimate"),
        ({"estimate_topics": ["/vio odometry"]}, "'/vio odometry' is not a topic name"),
        ({"publish_rate": 1e6}, "publish_rate"),
        ({"rerun": "bogus"}, "rerun must be none, file, serve"),
        ({"use_sim_time": 1}, "use_sim_time must be true or false"),
        ({"covariance": True}, "parameter covariance can't be true"),
        ({"hand_eye": "none.yaml"}, "none.yaml"),
        ({"hand_eye": "/tf_static:base"}, "'/tf_static:base' has no pair of frames"),
        ({"broadcast_tf": "yes please"}, "broadcast_tf must be true or false, not 'yes please'"),
        ({"broadcast_tf": True, "gauge": "sim3"}, "since a transform has no scale"),
        ({"output": "FILE/out"}, "can't be created: not a directory"),
    ],
)
def test_a_wrong_parameter_is_one_sentence(
    values: dict[str, Any], complaint: str, environment: dict[str, str], tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    values = {"output": str(tmp_path / "out"), **TOPICS, **values}
    values["output"] = values["output"].replace("FILE", str(file))
    done = run_evaluator(environment, *parameters(**values))
    assert done.returncode == 2, done.stderr
    actual = [line for line in done.stderr.splitlines() if line.startswith("trajeval: ")]
    assert len(actual) == 1, done.stderr
    assert complaint in actual[0]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_odd_parameters_are_understood_and_an_existing_folder_is_left_alone(
    environment: dict[str, str], tmp_path: Path
) -> None:
    kept = tmp_path / "out" / "notes.txt"
    kept.parent.mkdir()
    kept.write_text("of last week")
    odd = {"max_gap": 1, "window": 500, "align_states": 20, "windw": "3s", "estimate_topics": "/v"}
    with evaluating(
        tmp_path / "out", environment, *parameters(**odd), groundtruth="/groundtruth"
    ) as evaluator:
        evaluator.wait_for("unknown parameter windw; did you mean window?")
        evaluator.wait_for(f"output folder: {tmp_path / 'out_2'}")
        assert evaluator.end() == 2
    assert "no pairs of estimate and groundtruth" in evaluator.printed
    assert [path.name for path in kept.parent.iterdir()] == ["notes.txt"]
    result = {path.name for path in (tmp_path / "out_2").iterdir()}
    assert result == {"groundtruth.states", "v.states", "metrics.prom"}


def test_a_node_that_only_watches_names_unknown_parameters(
    environment: dict[str, str], tmp_path: Path
) -> None:
    values = {"watch_factor": 2.0, "watch_facto": 3.0, "estimates": ["/odom"]}
    quality = "qos_overrides./odom.subscription.reliability"
    values[quality] = "best_effort"
    with evaluating(tmp_path / "out", environment, groundtruth="", **values) as evaluator:
        evaluator.wait_for("unknown parameter watch_facto; did you mean watch_factor?")
        evaluator.wait_for(f"parameter {quality} has no effect")
        assert evaluator.end() == 0


def test_a_topic_without_poses_is_named_with_what_it_carries(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_msgs.msg import Float64

    publisher = peer.publisher("/groundtruth", Float64)
    with evaluating(
        tmp_path / "out", environment, groundtruth="/groundtruth", estimates=["/nobody"]
    ) as evaluator:
        evaluator.wait_for(
            "/groundtruth has type std_msgs/msg/Float64, not a supported type of poses"
        )
        evaluator.wait_for("no publisher on /nobody, and no poses on any other topic")
        assert evaluator.end() == 2
    peer.node.destroy_publisher(publisher)


def test_the_log_and_diagnostics_show_control_characters(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from std_srvs.srv import Trigger

    heard = peer.hear("/diagnostics", DiagnosticArray)
    folder, shown = tmp_path / "out\x1b[31m\u202e", rf"{tmp_path}/out\x1b[31m\u202e"
    with evaluating(folder, environment, groundtruth="/groundtruth") as evaluator:
        evaluator.wait_for(f"output folder: {shown}")
        peer.until(lambda: any(item.status for item in heard), "diagnostics")
        answer = peer.ask("/evaluator/reset", Trigger).message
        [refused] = peer.set("/evaluator", window="\x1b[31m")
        assert evaluator.end() == 2
    assert shown in answer
    assert r"\x1b[31m" in refused.reason
    values = [value.value for array in heard for status in array.status for value in status.values]
    assert shown in values
    text = [evaluator.printed, answer, refused.reason, *values]
    assert not {"\x1b", "\u202e"} & set("".join(text))
