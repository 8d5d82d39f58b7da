"""Writes results while the node runs: periodically, on request, and of past runs."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.task import Future

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.output_folder import Autosave, Finisher
from trajeval_ros.ros.unused_messages import why_no_pair

Log = Callable[[str, bool], object]


class ResultWriting:
    """Starts the processes that write results, and reports how they end."""

    def __init__(self, current: Callable[[], LiveRun], log: Log) -> None:
        """Create it.

        Args:
            current: Returns the present run, which a reset replaces.
            log: Called with a sentence, and whether it is a warning.
        """
        self._current, self._log = current, log
        self._autosaving = Autosave()
        self._saved = Future()  # done when the running process has ended
        self._past: list[Finisher] = []  # finishers of complete runs and folders
        self._complaint = ""

    def tell(self, period_s: float) -> None:
        """Report written results, and start to write again after a period, seconds."""
        self._complain()
        finisher = self._current().folders.finisher
        if finisher.poll():
            self._wake()
        for each in self._past:
            if each.poll() and each.trouble:
                self._log(f"results can't be written to {each.folder}: {each.trouble}", True)
        self._past = [each for each in self._past if each.is_busy]
        if self._autosaving.is_due(finisher, period_s):
            self._begin()
        if late := self._autosaving.why_late(finisher, period_s):
            self._log(late, False)

    async def saved(self) -> tuple[bool, str]:
        """Write result.json; return whether it was written, and where or why not."""
        # A running process does not have the newest pairs.
        while self._current().folders.finisher.is_busy:
            await self._saved
        finisher = self._current().folders.finisher
        if why_not := self._begin():
            return False, why_not
        await self._saved
        result = finisher.folder / "result.json"
        if finisher is not self._current().folders.finisher:
            return False, f"{result}, interrupted by ~/reset, is now written"
        return not finisher.trouble, finisher.trouble or str(result)

    def finish(self, run: LiveRun) -> None:
        """Start to write the final results of a run that a reset has ended."""
        if run.has_pairs:
            self._finish(run.folders.finisher)
        self._wake()

    def finish_left_folders(self, run: LiveRun) -> None:
        """Start to write the final results of folders that a run has left."""
        for finisher in run.folders.complete():
            self._log(f"results of {finisher.folder} are complete", False)
            self._finish(finisher)

    def _finish(self, finisher: Finisher) -> None:
        finisher.finish_alone()
        self._past.append(finisher)

    def _begin(self) -> str:
        """Start to write result.json; return the reason if that is not possible, else ""."""
        run = self._current()
        if not run.has_pairs:
            return why_no_pair(run)
        self._autosaving.saved()
        try:
            run.save()
        except TrajevalError as error:
            self._log(str(error), True)
            return str(error)
        return ""

    def _wake(self) -> None:
        """Resume all calls of `saved` that wait for a process."""
        saved, self._saved = self._saved, Future()
        saved.set_result(None)

    def _complain(self) -> None:
        """Report once that the disk can't be written, and once that it can be written again."""
        run = self._current()
        troubles = [each.files.pairs.trouble for each in run.estimates if each.files.pairs.trouble]
        if run.has_pairs and run.folders.finisher.trouble:
            troubles.append(run.folders.finisher.trouble)
        complaint = troubles[0] if troubles else ""
        if complaint != self._complaint:
            folder = run.folders.finisher.folder
            said = f"results can't be written to {folder}: {complaint}" if complaint else ""
            self._log(said or f"results are written to {folder} again", bool(complaint))
        self._complaint = complaint
