"""`trajeval simulate`: bags to try everything on, without a robot."""

from __future__ import annotations

import dataclasses
import math
import shlex
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.temporary import temporary_folder

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory

GROUNDTRUTH_TOPIC = "/groundtruth/pose"
ESTIMATE_TOPIC = "/vio/odometry"
_DRIFT = "drift"
# What a marker differs by from the body that it is on: m, rad, s.
_LEVER_M = (0.1, -0.05, 0.2)
_TURN = (0.6, -1.0, 1.5)
_AHEAD_S = 0.1


class Storage(str, Enum):
    """The storage plugins of rosbag2 that a bag can be written with."""

    MCAP = "mcap"
    SQLITE3 = "sqlite3"


def simulate(
    output: Annotated[
        Path,
        typer.Argument(
            metavar="BAG", help="Folder to write the rosbag2 bag to; it must not exist yet."
        ),
    ],
    seed: Annotated[
        int,
        typer.Option(help="Chooses flight, frames and drift; the same seed, the same messages."),
    ] = 0,
    duration: Annotated[
        float,
        typer.Option(metavar="S", help="Length of the flight, seconds; it flies 1.8 m/s or so."),
    ] = 120.0,
    storage: Annotated[
        Storage,
        typer.Option(help="File format inside of the bag: mcap (Jazzy's default) or sqlite3."),
    ] = Storage.MCAP,
    profile: Annotated[
        str,
        typer.Option(
            metavar="drift|paper|euroc|stereo|overconfident",
            help="drift: a kinematic model without covariance. The others: a visual-inertial "
            "estimator with covariance, honest with the sensors of the gauge paper, the same and "
            "a second camera (stereo), or those of EuRoC (at most 1800 s), or too sure of itself "
            "(at most 10 s): residuals look fine, and the joint NEES is several times its degrees "
            "of freedom.",
        ),
    ] = _DRIFT,
    runs: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Bags of the same flight with other noise, BAG_0, BAG_1, ...; not for drift.",
        ),
    ] = 1,
    marker: Annotated[
        bool,
        typer.Option(
            "--marker",
            help="Groundtruth of a marker on the body instead of the body, by a clock that is "
            "100 ms ahead: as a motion capture system gives it. For drift alone.",
        ),
    ] = False,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="Replace BAG, and BAG.npz of a profile, if an earlier `trajeval simulate` wrote "
            "them.",
        ),
    ] = False,
) -> None:
    """Write a bag with a simulated flight: true poses, and the odometry of a VIO.

    By default the odometry is a kinematic drift model, not an estimator: yaw, position and scale
    wander off, roll and pitch don't, stamps jitter, its frame is its own, and it is silent for
    2 s. A bag, and how wrong the odometry in it is:

        trajeval simulate flight

        trajeval evaluate -g flight:/groundtruth/pose -e flight:/vio/odometry --gauge yaw

    With a profile it is that of a visual-inertial estimator, 10 keyframes a second, each with the
    covariance of its pose; the joint covariance of all of them is in fly.npz:

        trajeval simulate fly --profile euroc

        trajeval evaluate -g fly:/groundtruth/pose -e fly:/vio/odometry --covariance fly.npz
    """
    if profile == _DRIFT:
        if runs != 1:
            raise SettingsError("--runs is for estimators: choose one by --profile euroc")
        _write_drift(output, seed, duration, storage, marker=marker, overwrite=overwrite)
    else:
        if marker:
            raise SettingsError("--marker is for the drift model: leave out --profile")
        _write_runs(output, seed, duration, storage, profile, runs, overwrite=overwrite)


def _write_runs(
    output: Path,
    seed: int,
    duration: float,
    storage: Storage,
    profile: str,
    runs: int,
    *,
    overwrite: bool,
) -> None:
    """Write runs of the estimator: a bag and a joint covariance each."""
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.consistency.joint_covariance import JointCovariance
    from trajeval_ros.io.bags.write_bag import write_bag
    from trajeval_ros.io.requests.covariance_file import write_joint_covariance
    from trajeval_ros.visual_inertial.flight import fly
    from trajeval_ros.visual_inertial.scene import PROFILES

    if profile not in PROFILES:
        raise SettingsError(
            f"there is no profile {profile!r}; use one of {_DRIFT}, {', '.join(PROFILES)}"
        )
    if runs < 1 or seed < 0:
        raise SettingsError("--runs must be at least 1, and --seed at least 0")
    if output.name in ("", ".."):
        raise SettingsError(
            f"{output} has no name of its own to call bags and covariances after; name a new "
            "folder, such as fly"
        )
    flight = fly(seed, duration, PROFILES[profile])
    bags = [output]
    if runs > 1:
        bags = [output.with_name(f"{output.name}_{number}") for number in range(runs)]
    for bag in bags:
        _make_way_for_covariance(_covariance_of(bag), overwrite=overwrite)
        _make_way(bag, overwrite=overwrite)
    output.parent.mkdir(parents=True, exist_ok=True)
    with progress(f"{runs} runs of {duration:g} s") as advance:
        for number, (bag, odometry) in enumerate(
            zip(bags, flight.runs(seed, runs), strict=True), start=1
        ):
            estimate = odometry.estimate
            write_bag(bag, _topics(flight.groundtruth, estimate), storage=storage.value)
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
    beside = f", {how}, with the joint covariance in {_covariance_of(bags[0]).name}"
    _say(bags, flight.groundtruth, estimate, beside, covariance)


def _covariance_of(bag: Path) -> Path:
    """Return where the joint covariance of a bag's odometry is."""
    return bag.with_name(f"{bag.name}.npz")


def _topics(groundtruth: Trajectory, estimate: Trajectory) -> dict[str, tuple[Trajectory, str]]:
    return {
        GROUNDTRUTH_TOPIC: (groundtruth, "geometry_msgs/msg/PoseStamped"),
        ESTIMATE_TOPIC: (estimate, "nav_msgs/msg/Odometry"),
    }


def _write_drift(
    output: Path, seed: int, duration: float, storage: Storage, *, marker: bool, overwrite: bool
) -> None:
    """Write a flight with the kinematic drift model."""
    from trajeval_ros.io.bags.write_bag import write_bag
    from trajeval_ros.visual_inertial import drifting_odometry

    simulated = drifting_odometry.simulate(seed, duration)
    _make_way(output, overwrite=overwrite)
    output.parent.mkdir(parents=True, exist_ok=True)
    groundtruth, more, options = simulated.groundtruth, "", ""
    if marker:
        groundtruth = _marked(groundtruth)
        lever = " ".join(f"{each:g}" for each in _LEVER_M)
        angle_deg = math.degrees(math.hypot(*_TURN))
        more = (
            f"; the groundtruth is of a marker, {lever} m away from the body and turned by "
            f"{angle_deg:.1f} deg, and {1e3 * _AHEAD_S:g} ms ahead"
        )
        options = " --time-offset auto --hand-eye auto"
    write_bag(output, _topics(groundtruth, simulated.estimate), storage=storage.value)
    _say([output], groundtruth, simulated.estimate, more, options)


def _marked(groundtruth: Trajectory) -> Trajectory:
    """Return groundtruth of the body as a motion capture system sees it."""
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
) -> None:
    """Print what was written, and what to do with it."""
    names = f"{bags[0]} to {bags[-1]}" if len(bags) > 1 else str(bags[0])
    print(
        f"wrote {names}: {groundtruth.duration_s:.0f} s and {groundtruth.path_length_m:.0f} m of "
        f"flight, {len(groundtruth)} poses on {GROUNDTRUTH_TOPIC}, {len(estimate)} on "
        f"{ESTIMATE_TOPIC}{more}"
    )
    bag = shlex.quote(str(bags[0]))
    print(
        f"next: trajeval evaluate --groundtruth {bag}:{GROUNDTRUTH_TOPIC} "
        f"--estimate {bag}:{ESTIMATE_TOPIC} --modality stereo-inertial{options}"
    )


def _make_way(output: Path, *, overwrite: bool) -> None:
    """Remove an earlier simulation's bag if asked to, and nothing else ever."""
    if not output.exists() and not output.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{output} exists; name another folder, or add --overwrite")
    if not is_simulated(output):
        raise InputError(
            f"{output} is not a bag that trajeval simulate wrote, so it is not overwritten; "
            "name another folder"
        )
    # A kill must not leave half of it, which nobody would take for a simulation's.
    with temporary_folder(output.name, output.parent) as going:
        output.rename(going / output.name)


def _make_way_for_covariance(file: Path, *, overwrite: bool) -> None:
    """Refuse to replace a file beside a bag, unless asked to and it is a joint covariance."""
    from trajeval_ros.io.requests.covariance_file import read_joint_covariance

    if not file.exists() and not file.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{file} exists; name another folder, or add --overwrite")
    try:
        read_joint_covariance(file)
    except InputError as error:
        raise InputError(
            f"{file} is not a joint covariance that trajeval simulate wrote, so it is not "
            "overwritten; name another folder"
        ) from error


def is_simulated(folder: Path) -> bool:
    """Whether a folder holds a bag with the two simulated topics, and no other file."""
    metadata = folder / "metadata.yaml"
    if folder.is_symlink() or not metadata.is_file():
        return False
    others = [file for file in folder.iterdir() if file != metadata]
    if not all(file.is_file() and file.suffix in (".mcap", ".db3") for file in others):
        return False
    lines = metadata.read_text(encoding="utf-8", errors="replace").splitlines()
    topics = {
        line.split("name:", 1)[1].strip(" '\"")
        for line in lines
        if line.strip().startswith("name: /")
    }
    return topics == {GROUNDTRUTH_TOPIC, ESTIMATE_TOPIC}
