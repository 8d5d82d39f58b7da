"""Runs of which outputs are kept: recordings of simulations, and estimates with mistakes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from kept import assert_kept, shortened

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.save_trajectories import write_euroc, write_tum
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.simulation.drifting_odometry import simulate


def write_kept_runs(folder: Path) -> None:
    """Write bags, `truth.txt`, `a.txt` to `d.txt`, which ends early, and mistakes by name."""
    short = ["--duration", "40", "--seed", "3"]
    for name, more in {
        "run": short,
        "drive": [*short, "--gnss", "rtk"],
        "fault": ["--duration", "60", "--fault", "jump"],
        "vi": ["--duration", "12", "--profile", "stereo"],
    }.items():
        assert main(["simulate", str(folder / name), *more]) == 0
    flight = simulate(3, 40.0)
    write_tum(folder / "truth.txt", flight.groundtruth[::4])
    for place, name in enumerate("abcd"):
        walk = np.random.default_rng(place).normal(size=flight.estimate.positions.shape)
        moved = flight.estimate.positions + 3e-3 * place * walk.cumsum(axis=0)
        estimate = dataclasses.replace(flight.estimate, positions=moved)
        write_tum(folder / f"{name}.txt", estimate[: len(moved) // 2] if name == "d" else estimate)
    for name, mistaken in mistakes(flight.estimate, flight.groundtruth[::4]).items():
        write = write_tum if mistaken.velocities is None else write_euroc
        write(folder / f"{name}.txt", mistaken)
    (folder / "lever.yaml").write_text(
        "transform: {translation: {x: 0.3, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 0, w: 1}}\n"
    )
    truth = flight.groundtruth[::4]
    rows = np.arange(len(truth))
    frozen = np.where((rows > 500) & (rows < 530), 500, rows)  # and a gap of 0.6 s
    worn = dataclasses.replace(truth, positions=truth.positions[frozen])
    write_tum(folder / "worn.txt", worn[(rows < 100) | (rows > 130)])


def mistakes(estimate: Trajectory, truth: Trajectory) -> dict[str, Trajectory]:
    """Return estimates, each with a mistake."""
    positions, rotations, speeds = estimate.positions, estimate.quaternions, estimate.velocities
    assert rotations is not None
    assert speeds is not None
    estimate = dataclasses.replace(estimate, velocities=None)
    seconds = (estimate.stamps - estimate.stamps[0]) / 1e9
    middle = len(estimate) // 2
    early = np.minimum(np.arange(len(estimate)), middle)
    lever = lie.rotate(rotations, np.array([0.8, 0.0, 0.3]))
    tilt = np.broadcast_to(lie.from_rotation_vector(np.array([0.3, 0.0, 0.0])), rotations.shape)

    def changed(**values: object) -> Trajectory:
        return dataclasses.replace(estimate, **values)

    return {
        "copy": dataclasses.replace(truth, velocities=None),
        "late": changed(stamps=estimate.stamps + 700_000_000),
        "fast_clock": changed(stamps=estimate.stamps + np.int64(5e6 * seconds)),
        "scaled": changed(positions=1.2 * positions),
        "millimetres": changed(positions=1000.0 * positions),
        "w_first": changed(quaternions=rotations[:, [3, 0, 1, 2]]),
        "inverted": changed(quaternions=lie.conjugate(rotations)),
        "mirrored": changed(positions=positions * [1.0, -1.0, 1.0]),
        "optical": changed(positions=positions[:, [2, 0, 1]]),
        "level": changed(positions=positions * [1.0, 1.0, 0.0]),
        "frozen": changed(positions=positions[early], quaternions=rotations[early]),
        "diverged": changed(positions=positions + np.maximum(seconds - 25.0, 0.0)[:, None] ** 3),
        "restarted": changed(
            positions=positions - np.where(early == middle, 1.0, 0.0)[:, None] * positions[middle]
        ),
        "lever": changed(positions=positions + lever),
        "tilted": changed(quaternions=lie.multiply(rotations, tilt)),
        "sparse": estimate[::40],
        "rounded": changed(stamps=estimate.stamps // 100_000_000 * 100_000_000),
        "twisted": changed(velocities=lie.rotate(lie.conjugate(rotations), speeds)),
        "other": dataclasses.replace(simulate(5, 40.0).estimate, velocities=None),
    }


def printed(typed: str, runs: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command in a folder that has links to the runs, and return what it printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for path in runs.iterdir():
            Path(path.name).symlink_to(path)
        status = main(typed.split())
    text = capsys.readouterr()
    parts = (f"$ trajeval {typed}\nstatus {status}\n", text.err, text.out)
    return "\n".join(parts).replace(str(folder), "FOLDER")


def assert_prints(
    name: str, typed: str, runs: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Compare what a command prints with the kept text."""
    assert_kept(name, printed(typed, runs, folder, capsys))


def told(source: str) -> str:
    """Return how many poses are read with which remarks, or the sentence that refuses it."""
    try:
        read = read_trajectory(source)
    except InputError as error:
        return str(error)
    text = [f"{remark.level.name} {remark.text}" for remark in read.reading.remarks]
    text += [f"dropped: {count}, {why}" for why, count in read.reading.dropped.items()]
    places = shortened(read.positions.sum(axis=0))
    return f"{len(read)} poses, sum {places}, last {read.stamps[-1]} ns; {'; '.join(text)}"
