"""`trajeval simulate`: a bag to try everything on, without a robot."""

from __future__ import annotations

import shlex
import shutil
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros.exceptions import InputError

GROUNDTRUTH_TOPIC = "/groundtruth/pose"
ESTIMATE_TOPIC = "/vio/odometry"


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
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Replace BAG if an earlier `trajeval simulate` wrote it."
        ),
    ] = False,
) -> None:
    """Write a bag with a simulated flight: true poses and an odometry that drifts like a VIO's.

    The odometry is a kinematic drift model, not an estimator: yaw, position and scale wander off,
    roll and pitch don't, stamps jitter, its frame is its own, and it is silent for 2 s.

    A bag, and how wrong the odometry in it is:

        trajeval simulate flight

        trajeval evaluate -g flight:/groundtruth/pose -e flight:/vio/odometry --gauge yaw
    """
    from trajeval_ros import simulation
    from trajeval_ros.io.write_bag import write_bag

    simulated = simulation.simulate(seed, duration)
    _make_way(output, overwrite=overwrite)
    output.parent.mkdir(parents=True, exist_ok=True)
    write_bag(
        output,
        {
            GROUNDTRUTH_TOPIC: (simulated.groundtruth, "geometry_msgs/msg/PoseStamped"),
            ESTIMATE_TOPIC: (simulated.estimate, "nav_msgs/msg/Odometry"),
        },
        storage=storage.value,
    )
    truth, estimate = simulated.groundtruth, simulated.estimate
    bag = shlex.quote(str(output))
    print(
        f"wrote {output}: {truth.duration_s:.0f} s and {truth.path_length_m:.0f} m of flight, "
        f"{len(truth)} poses on {GROUNDTRUTH_TOPIC}, {len(estimate)} on {ESTIMATE_TOPIC}"
    )
    print(
        f"next: trajeval evaluate --groundtruth {bag}:{GROUNDTRUTH_TOPIC} "
        f"--estimate {bag}:{ESTIMATE_TOPIC} --modality stereo-inertial"
    )


def _make_way(output: Path, *, overwrite: bool) -> None:
    """Remove an earlier simulation's bag if asked to, and nothing else ever."""
    if not output.exists() and not output.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{output} exists; name another folder, or add --overwrite")
    if not _is_simulated(output):
        raise InputError(
            f"{output} is not a bag that trajeval simulate wrote, so it is not overwritten; "
            "name another folder"
        )
    shutil.rmtree(output)


def _is_simulated(folder: Path) -> bool:
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
