"""Where a generated pair of files is, by its number of poses."""

from __future__ import annotations

from pathlib import Path


def pair_paths(folder: Path, count: int) -> tuple[Path, Path]:
    """Return the paths of the groundtruth and the estimate."""
    return folder / f"groundtruth_{count}.tum", folder / f"estimate_{count}.tum"
