"""Recordings for Rerun's viewer that a verb writes or shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.pipeline.outcome import RunOutcome

PICTURE = "run.rrd"


@dataclass(frozen=True)
class Pictures:
    """The requested output for Rerun's viewer."""

    rrd: Path | None = None  # file to write
    viewer: bool = False  # whether to open the viewer

    def check(self) -> None:
        """Check that rerun-sdk is installed if it is needed, before anything is computed."""
        if self.rrd is not None or self.viewer:
            from trajeval_ros.viewer.sdk import sdk

            sdk()

    def write(self, runs: Sequence[RunOutcome]) -> None:
        """Write the file if one is requested."""
        if self.rrd is not None:
            _write(self.rrd, runs)

    def show(self, runs: Sequence[RunOutcome]) -> None:
        """Open the viewer if requested, and wait until it is closed."""
        if not self.viewer:
            return
        from trajeval_ros.viewer.program import show

        if self.rrd is not None:
            show(self.rrd)
            return
        from trajeval_ros.io.writing import temporary_folder

        with temporary_folder("picture") as folder:
            made = folder / PICTURE
            _write(made, runs)
            show(made)


def _write(path: Path, runs: Sequence[RunOutcome]) -> None:
    from trajeval_ros.viewer.recorded_scene import write_recording

    columns = ((run.evaluation, run.consistency, run.available) for run in runs)
    write_recording(path, *zip(*columns, strict=True))
