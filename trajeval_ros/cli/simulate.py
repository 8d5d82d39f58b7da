"""`trajeval simulate`: bags of simulated flights."""

from __future__ import annotations

import dataclasses
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import argument, option
from trajeval_ros.cli.simulated_bag import (
    ESTIMATE_TOPIC,
    FIX_TOPIC,
    GROUNDTRUTH_TOPIC,
    IMU_TOPIC,
    make_way_for_covariance,
    remove_existing,
)
from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.formatting.numbers import counted

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory

FIX_TYPE = "sensor_msgs/msg/NavSatFix"
RECEIVERS = ("rtk", "consumer")
STORAGES = ("mcap", "sqlite3")  # plugins of rosbag2
_DRIFT, _SLOW = "drift", "slow"
_FAULTS = ("yaw", "jump", "freeze", "divergence")
# Lever arm (m), rotation (rad) and time offset (s) of the marker relative to the body.
_LEVER_M = (0.1, -0.05, 0.2)
_TURN = (0.6, -1.0, 1.5)
_AHEAD_S = 0.1


_PARAMETERS = (
    argument("output", kind=Path, metavar="BAG",
        help="Output folder of the rosbag2 bag. It must not exist."),
    option("--seed", kind=int, default=0,
        help="Seed of flight, frames and drift. The same seed gives the same messages."),
    option("--duration", kind=float, metavar="S", default=120.0,
        help="Duration of the flight, in seconds. The speed is about 1.8 m/s."),
    option("--storage", metavar="|".join(STORAGES), kind=click.Choice(STORAGES),
        default=STORAGES[0],
        help="Storage format of the bag: mcap (default of Jazzy) or sqlite3."),
    option("--profile", metavar="NAME", default=_DRIFT,
        help="Odometry model. drift: kinematic model without covariance. slow: the same, received "
        "at least 0.12 s after its timestamp and with dropouts. paper, stereo, euroc: "
        "consistent visual-inertial estimator with covariance (at most 1800 s), with the "
        "sensors of the gauge paper, with a second camera, or with the sensors of EuRoC. "
        "overconfident: estimator whose joint NEES is several times its degrees of freedom (at "
        "most 10 s)."),
    option("--runs", kind=int, metavar="N", default=1,
        help="Number of bags of the same flight with different noise, BAG_0, BAG_1, ... Not for "
        "drift."),
    option("--marker", kind=bool,
        help="Groundtruth of a marker on the body, with a clock 100 ms ahead, as from a motion "
        "capture system. For drift only."),
    option("--gnss", metavar="|".join(RECEIVERS),
        help="Simulates a drive instead of a flight, with GNSS fixes on /fix: rtk (1 cm, with "
        "periods of float solutions) or consumer (1.2 m, with multipath). Errors are correlated "
        "over minutes, and there are outages. For drift only."),
    option("--fault", metavar="|".join(_FAULTS),
        help="Fault of the odometry after two thirds of the flight, to try `trajeval watch`. "
        "For drift only."),
    option("--overwrite", kind=bool,
        help="Replace BAG and BAG.npz if they are from an earlier `trajeval simulate`."),
)  # fmt: skip


@verb(*_PARAMETERS)
def simulate(
    output: Path,
    seed: int,
    duration: float,
    storage: Literal["mcap", "sqlite3"],
    profile: str,
    runs: int,
    marker: bool,
    gnss: str | None,
    fault: str | None,
    overwrite: bool,
) -> None:
    r"""Writes a bag with a simulated flight: true poses, VIO odometry and IMU data.

    By default, the odometry is a kinematic drift model without an estimator. Yaw, position and
    scale drift, roll and pitch do not. Timestamps have jitter, the frame is arbitrary, and one gap
    lasts 2 s. Simulate a bag and evaluate its odometry:

        trajeval simulate flight

        trajeval evaluate flight:/groundtruth/pose flight:/vio/odometry --gauge yaw

    Simulate a drive with an RTK receiver (docs/gnss.md):

        trajeval simulate drive --gnss rtk --duration 600

    With a profile, a visual-inertial estimator with 10 keyframes per second is simulated. Messages
    contain the covariance of their pose, and fly.npz contains the joint covariance of all
    keyframes:

        trajeval simulate fly --profile euroc

        trajeval evaluate fly:/groundtruth/pose fly:/vio/odometry \
            --covariance fly.npz
    """
    if profile in (_DRIFT, _SLOW):
        if runs != 1:
            raise SettingsError(
                "--runs needs a simulated estimator; choose one, as in --profile euroc"
            )
        if marker and gnss is not None:
            raise SettingsError("--marker and --gnss exclude each other; give one of them")
        if fault is not None and fault not in _FAULTS:
            raise SettingsError(f"--fault must be one of {', '.join(_FAULTS)}, not {fault!r}")
        _write_drift(
            output,
            seed,
            duration,
            storage,
            marker=marker,
            gnss=gnss,
            fault=fault,
            slow=profile == _SLOW,
            overwrite=overwrite,
        )
    else:
        if marker or gnss is not None or fault is not None:
            raise SettingsError(
                "--marker, --gnss and --fault need the drift model; remove --profile"
            )
        _write_runs(output, seed, duration, storage, profile, runs, overwrite=overwrite)


def _write_runs(
    output: Path,
    seed: int,
    duration: float,
    storage: Literal["mcap", "sqlite3"],
    profile: str,
    runs: int,
    *,
    overwrite: bool,
) -> None:
    """Write runs of the estimator: one bag and one joint covariance per run."""
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.consistency.joint_covariance import JointCovariance
    from trajeval_ros.io.bags.write_bag import write_bag
    from trajeval_ros.io.covariance_file import write_joint_covariance
    from trajeval_ros.papers.flight import fly
    from trajeval_ros.papers.scene import PROFILES
    from trajeval_ros.simulation.simulated_sensors import imu_readings

    require_one_of(profile, [_DRIFT, _SLOW, *PROFILES], "profile")
    if runs < 1 or seed < 0:
        raise SettingsError("--runs must be at least 1, and --seed at least 0")
    if output.name in ("", ".."):
        raise SettingsError(
            f"{output} has no folder name to derive file names from; give a new folder, such as "
            "flight"
        )
    flight = fly(seed, duration, PROFILES[profile])
    bags = [output]
    if runs > 1:
        bags = [output.with_name(f"{output.name}_{number}") for number in range(runs)]
    for bag in bags:
        make_way_for_covariance(_covariance_of(bag), overwrite=overwrite)
        remove_existing(bag, overwrite=overwrite)
    output.parent.mkdir(parents=True, exist_ok=True)
    with progress(f"{runs} runs of {duration:g} s") as advance:
        for number, (bag, odometry) in enumerate(
            zip(bags, flight.runs(seed, runs), strict=True), start=1
        ):
            estimate = odometry.estimate
            write_bag(
                bag,
                _topics(flight.groundtruth, estimate, seed),
                storage=storage,
                inertial={IMU_TOPIC: imu_readings(flight.groundtruth, seed)},
            )
            quaternions = estimate.quaternions
            assert quaternions is not None
            joint = JointCovariance(
                estimate.stamps,
                estimate.positions,
                quaternions,
                block=9,
                information=odometry.information,
                gauge="free",
            )
            write_joint_covariance(_covariance_of(bag), joint)
            advance(number, runs)
    how = "solved" if flight.is_solved else "sampled from the estimator's own distribution"
    covariance = f" --covariance {shlex.quote(str(_covariance_of(bags[0])))}"
    details = f", {how}, with the joint covariance in {_covariance_of(bags[0]).name}"
    _say(bags, flight.groundtruth, estimate, details, covariance)


def _covariance_of(bag: Path) -> Path:
    """Return the file with the joint covariance of a bag's odometry."""
    return bag.with_name(f"{bag.name}.npz")


def _topics(
    groundtruth: Trajectory, estimate: Trajectory, seed: int, *, slow: bool = False
) -> dict[str, tuple[Trajectory, str]]:
    """Return the trajectories by topic; the estimate with its receive times."""
    from trajeval_ros.simulation.odometry_faults import SLOW, USUAL, with_receive_times

    estimate = with_receive_times(estimate, SLOW if slow else USUAL, seed)
    return {
        GROUNDTRUTH_TOPIC: (groundtruth, "geometry_msgs/msg/PoseStamped"),
        ESTIMATE_TOPIC: (estimate, "nav_msgs/msg/Odometry"),
    }


def _write_drift(
    output: Path,
    seed: int,
    duration: float,
    storage: Literal["mcap", "sqlite3"],
    *,
    marker: bool,
    gnss: str | None,
    fault: str | None,
    slow: bool,
    overwrite: bool,
) -> None:
    """Write a flight with the kinematic drift model."""
    from trajeval_ros.io.bags.write_bag import write_bag
    from trajeval_ros.simulation import drifting_odometry
    from trajeval_ros.simulation.simulated_sensors import imu_readings

    simulated = drifting_odometry.simulate(seed, duration, drives=gnss is not None)
    remove_existing(output, overwrite=overwrite)
    output.parent.mkdir(parents=True, exist_ok=True)
    groundtruth, more, options = simulated.groundtruth, "", ""
    estimate = simulated.estimate
    if fault is not None:
        estimate, more = _with_fault(estimate, fault, seed)
    topics = _topics(groundtruth, estimate, seed, slow=slow)
    if gnss is not None:
        from trajeval_ros.simulation.simulated_sensors import ANTENNA_M, gnss_fixes

        fixes = gnss_fixes(groundtruth, gnss, seed)
        write_bag(output, topics | {FIX_TOPIC: (fixes, FIX_TYPE)}, storage=storage)
        more += f", {counted(len(fixes), 'fix', 'fixes')} of a {gnss} receiver on {FIX_TOPIC}"
        options = f" --lever-arm {','.join(f'{item:g}' for item in ANTENNA_M)}"
        options += " --max-fix-sigma 0.05" if gnss == "rtk" else ""
        _say([output], groundtruth, estimate, more, options, FIX_TOPIC)
        return
    if marker:
        groundtruth = _marked(groundtruth)
        lever = " ".join(f"{item:g}" for item in _LEVER_M)
        angle_deg = math.degrees(math.hypot(*_TURN))
        more += (
            f"; the groundtruth is the pose of a marker, {lever} m from the body and rotated by "
            f"{angle_deg:.1f} deg, with a clock {1e3 * _AHEAD_S:g} ms ahead"
        )
        options = " --time-offset auto --hand-eye auto"
    write_bag(
        output,
        _topics(groundtruth, estimate, seed, slow=slow),
        storage=storage,
        inertial={IMU_TOPIC: imu_readings(simulated.groundtruth, seed)},
    )
    _say([output], groundtruth, estimate, more, options)


def _with_fault(estimate: Trajectory, fault: str, seed: int) -> tuple[Trajectory, str]:
    """Return the estimate with a fault after two thirds of the time, and its description."""
    import numpy as np

    from trajeval_ros.simulation.odometry_faults import FAULTS

    words, apply = FAULTS[fault]
    after_s = round(estimate.duration_s * 2.0 / 3.0)
    onset = int(estimate.stamps[0]) + after_s * 10**9
    bad = apply(estimate, onset, np.random.default_rng(seed))
    return bad, f"; from {after_s} s on {words}"


def _marked(groundtruth: Trajectory) -> Trajectory:
    """Return the groundtruth of a marker on the body, in the clock of a motion capture system."""
    import numpy as np

    from trajeval_ros.geometry.marker import HandEye

    of_marker = HandEye.of(np.array(_TURN), np.array(_LEVER_M)).inverse().of_body(groundtruth)
    return dataclasses.replace(of_marker, stamps=of_marker.stamps + round(_AHEAD_S * 1e9))


def _say(
    bags: list[Path],
    groundtruth: Trajectory,
    estimate: Trajectory,
    more: str = "",
    options: str = "",
    measured_by: str = GROUNDTRUTH_TOPIC,
) -> None:
    """Print the written bags and the next command."""
    what = "a drive" if measured_by == FIX_TOPIC else "flight"
    names = f"{bags[0]} to {bags[-1]}" if len(bags) > 1 else str(bags[0])
    print(
        f"wrote {names}: {groundtruth.duration_s:.0f} s and {groundtruth.path_length_m:.0f} m of "
        f"{what}, {counted(len(groundtruth), 'pose')} on {GROUNDTRUTH_TOPIC}, {len(estimate)} "
        f"on {ESTIMATE_TOPIC}, and the IMU on {IMU_TOPIC}{more}"
    )
    bag = shlex.quote(str(bags[0]))
    print(
        f"next: trajeval evaluate --groundtruth {bag}:{measured_by} "
        f"--estimate {bag}:{ESTIMATE_TOPIC} --modality stereo-inertial{options}"
    )
