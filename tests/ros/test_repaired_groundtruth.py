"""NEES over DDS against a repaired groundtruth: that of the recording, with its noise."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from consistency_runs import with_growing_covariances
from examined_rigs import rig
from ros_bags import ODOM, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, assert_same, evaluating, offline

from trajeval_ros.calibration.groundtruth_quality.examine import examine
from trajeval_ros.online.error_topics import NEES_NUMBERS

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros


def test_nees_against_a_repaired_groundtruth_is_published_as_the_recording_has_it(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_msgs.msg import Float64

    made = rig(2, turn_deg=(3.0, -2.0, 1.5))
    fits = examine(made.groundtruth, made.readings).fits
    assert fits is not None
    repaired, every = fits.repaired, slice(None, None, 5)
    assert repaired.covariances is not None
    # As the command prints it: medians over the poses, per axis.
    variances = np.median(np.einsum("nii->ni", repaired.covariances), axis=0)
    noise_m, noise_rad = np.sqrt([variances[:3].mean(), variances[3:].mean()])
    noise = f"{noise_m:.2g},{np.degrees(noise_rad):.2g}"
    estimate = with_growing_covariances(repaired[every])
    drawn = np.random.default_rng(0).normal(0.0, 0.03, (len(estimate), 3))
    estimate = dataclasses.replace(estimate, positions=estimate.positions + drawn)
    bag, sides = tmp_path / "bag", ((repaired, GROUNDTRUTH), (estimate, ODOMETRY))
    both = [message for side, topic in sides for message in messages_of(side, topic, ODOM)]
    write_messages(bag, sorted(both, key=lambda item: item[2]))
    words = ("--gauge", "yaw", "--lengths", "none", "--covariance", "message")
    exact, expected = (
        offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *words, *more)
        for more in ((), ("--groundtruth-noise", noise))
    )
    [means, of_exact] = (
        [item["mean"], item["position"]["mean"], item["rotation"]["mean"]]
        for item in (one["runs"][0]["consistency"]["per_pose"] for one in (expected, exact))
    )
    assert (np.less(means, of_exact)).all()  # the noise counts
    heard = [peer.hear(f"/evaluator/vio_odometry/{name}", Float64) for name in NEES_NUMBERS]
    values = {
        "gauge": "yaw", "lengths": "none", "window": "0", "covariance": "message",
        "groundtruth_noise": noise,
    }  # fmt: skip
    with evaluating(tmp_path / "live", environment, **values) as live:
        peer.play(bag, {GROUNDTRUTH: 1, ODOMETRY: 1}, ["evaluator"], rate=8.0)
        for name, messages, mean in zip(NEES_NUMBERS, heard, means, strict=True):
            peer.until(
                lambda: any(message.data == pytest.approx(mean, rel=1e-9) for message in messages),  # noqa: B023
                f"{name} {mean:g} of the whole run, after {[item.data for item in messages][-3:]}",
            )
        assert live.end() == 0
    assert_same(live.result, expected)
