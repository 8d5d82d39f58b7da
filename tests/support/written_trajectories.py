"""Trajectories written as text files."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory


def write(path: Path, trajectory: Trajectory, *, oriented: bool = True) -> None:
    """Write TUM columns, or stamps and positions alone."""
    rows = []
    for place, stamp in enumerate(trajectory.stamps.tolist()):
        numbers = trajectory.positions[place].tolist()
        if oriented:
            assert trajectory.quaternions is not None
            numbers += trajectory.quaternions[place].tolist()
        else:
            numbers += [0.0, 0.0, 0.0, 1.0]
        rows.append(
            f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d} "
            + " ".join(f"{number:.9f}" for number in numbers)
        )
    path.write_text("\n".join(rows) + "\n")
