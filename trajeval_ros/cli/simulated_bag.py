"""Topics of a simulated bag, by which earlier simulations are recognised and replaced."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.writing import temporary_folder

GROUNDTRUTH_TOPIC = "/groundtruth/pose"
ESTIMATE_TOPIC = "/vio/odometry"
FIX_TOPIC = "/fix"
IMU_TOPIC = "/imu"


def remove_existing(output: Path, *, overwrite: bool) -> None:
    """Remove the bag of an earlier simulation if `overwrite` is set; never remove other files."""
    if not output.exists() and not output.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{output} exists; choose another folder or add --overwrite")
    if not is_simulated(output):
        raise InputError(
            f"{output} is not a bag from trajeval simulate and is not overwritten; choose another "
            "folder"
        )
    # After a kill, a partly removed bag would not be recognised as a simulation.
    with temporary_folder(output.name, output.parent) as going:
        output.rename(going / output.name)


def make_way_for_covariance(file: Path, *, overwrite: bool) -> None:
    """Check that a file may be replaced: `overwrite` is set, and it is a joint covariance."""
    from trajeval_ros.io.covariance_file import read_joint_covariance

    if not file.exists() and not file.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{file} exists; choose another folder or add --overwrite")
    try:
        read_joint_covariance(file)
    except InputError as error:
        raise InputError(
            f"{file} is not a joint covariance from trajeval simulate and is not overwritten; "
            "choose another folder"
        ) from error


def is_simulated(folder: Path) -> bool:
    """Return whether a folder contains a bag with only the simulated topics, and no other file."""
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
    return topics - {IMU_TOPIC, FIX_TOPIC} == {GROUNDTRUTH_TOPIC, ESTIMATE_TOPIC}
