"""The output folders of a live run: with `on_time_jump:=reset`, one per step back of time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.io.live.fix_file import FixWriter
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.output_folder import Finisher


class RunFolders:
    """Keeps the present folder, and previous ones that still get pairs.

    Attributes:
        finisher: Writes result.json of the present folder in another process.
    """

    def __init__(self, folder: Path, new_folder: Callable[[], Path] | None) -> None:
        """Create it.

        Args:
            folder: Existing folder.
            new_folder: Creates the folder for the time after a step back; None to keep one folder.
        """
        self.finisher = Finisher(folder)
        self._new_folder = new_folder
        self._leaving: list[Finisher] = []  # folders that still get pairs
        self._complete: list[Finisher] = []
        self._has_closed_pairs = False
        self._fix_writers: dict[Path, FixWriter] = {}

    def after_step_back(self, segment: LiveEstimate) -> Path:
        """Return the folder for the segment after one that time has ended."""
        # The first estimate that leaves a folder makes the next one.
        if self._new_folder is not None and segment.folder == self.finisher.folder:
            self._leaving.append(self.finisher)
            self.finisher = Finisher(self._new_folder())
            self._has_closed_pairs = False
        return self.finisher.folder

    def keep_fixes(self, folder: Path, stamps: Stamps, fixes: Floats) -> None:
        """Write the original fixes to disk, because pairs do not contain their quality."""
        if folder not in self._fix_writers:
            self._fix_writers[folder] = FixWriter(folder)
        self._fix_writers[folder].append(stamps, fixes)

    def see_closed(self, segment: LiveEstimate) -> None:
        """Remember whether a segment that is closed has pairs in the present folder."""
        here = segment.folder == self.finisher.folder
        self._has_closed_pairs |= here and segment.evaluator.pairs > 0

    def has_pairs(self, segments: Sequence[LiveEstimate]) -> bool:
        """Return whether there are pairs in the present folder; `segments` are not closed yet."""
        here = [each for each in segments if each.folder == self.finisher.folder]
        return self._has_closed_pairs or any(each.evaluator.pairs for each in here)

    def leave(self, segments: Sequence[LiveEstimate]) -> None:
        """Complete the previous folders to which none of the open segments belongs."""
        left = {each.folder for each in segments}
        self._complete += [each for each in self._leaving if each.folder not in left]
        self._leaving = [each for each in self._leaving if each.folder in left]

    def complete(self) -> list[Finisher]:
        """Return the finishers of folders that were completed since the last call."""
        complete, self._complete = self._complete, []
        return complete

    def close(self) -> list[Callable[[], None]]:
        """Complete the previous folders; return what closes the files of fixes."""
        self.leave([])
        return [each.close for each in self._fix_writers.values()]
