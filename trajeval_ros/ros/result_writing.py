"""Writes results while the node runs: periodically, on request, and of past runs."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.task import Future

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.output_folder import MOST_SHARE, Finisher
from trajeval_ros.ros.recorded_state import save, why_no_pair

Log = Callable[[str, Level], object]

# Pairs of the longest run whose last evaluation the node awaits: a few seconds on a core.
# `ros2 launch` kills a node 10 s after Ctrl-C by default. 400,000 pairs are 33 min at 200 Hz.
MOST_AWAITED = 400_000


class ResultWriting:
    """Starts the processes that write results, and reports how they end."""

    def __init__(self, current: Callable[[], LiveRun], log: Log) -> None:
        self._current, self._log = current, log
        self._saved_at = time.monotonic()
        self._told_s = 0.0  # the longer period that was last explained, seconds
        self._saved = Future()  # done when the running process has ended
        self._past: list[Finisher] = []  # finishers of previous runs
        self.has_finished = False  # whether a previous run had pairs

    def report(self, period_s: float) -> None:
        """Report written results, and start to write again after a period, seconds."""
        finisher = self._current().finisher
        if finisher.poll():
            self._wake()
        for item in self._past:
            if item.poll():
                failed = f"results can't be written to {item.folder}: {item.trouble}"
                text = failed if item.trouble else f"results of {item.folder} are complete"
                self._log(text, _level(item.trouble))
        self._past = [item for item in self._past if item.is_busy]
        if 0.0 < period_s <= time.monotonic() - self._saved_at and finisher.is_due:
            self._begin()
        self._explain_period(finisher.least_period_s, period_s)

    async def saved(self) -> tuple[bool, str]:
        """Write result.json; return whether it was written, and where or why not."""
        # A running process does not have the newest pairs.
        while self._current().finisher.is_busy:
            await self._saved
        finisher = self._current().finisher
        if why_not := self._begin():
            return False, why_not
        await self._saved
        result = finisher.folder / "result.json"
        if finisher is not self._current().finisher:
            return False, f"{result}, interrupted by ~/reset, is now written"
        return not finisher.trouble, finisher.trouble or str(result)

    def finish(self, run: LiveRun) -> None:
        """Start to write the final results of a run that another one has followed."""
        if run.has_pairs:
            self.has_finished = True
            run.finisher.finish_alone()
            self._past.append(run.finisher)
        self._wake()

    def conclude(self, run: LiveRun) -> bool:
        """Write the final results at the node's end; return whether no error is known.

        The process that evaluates a long run continues after the end of the node.
        """
        if run.pair_count <= MOST_AWAITED:
            return run.finisher.finish(quiet=False)
        run.finisher.finish_alone()
        self._log(
            "the evaluation of this long run continues in another process, which writes "
            f"result.json, errors.npz and figures into {run.folder}; until then, a result.json "
            "in it is of the last autosave; if the process is killed: trajeval finish "
            f"{run.folder}",
            Level.NOTE,
        )
        return True

    def _begin(self) -> str:
        """Start to write result.json; return the reason if that is not possible, else ""."""
        run = self._current()
        if not run.has_pairs:
            return why_no_pair(run)
        self._saved_at = time.monotonic()
        try:
            save(run)
        except TrajevalError as error:
            self._log(str(error), Level.WARNING)
            return str(error)
        return ""

    def _explain_period(self, least_s: float, asked_s: float) -> None:
        """Log why results are written less often than requested, once per doubling."""
        if 0.0 < asked_s < least_s and least_s >= 2.0 * self._told_s:
            self._told_s = least_s
            self._log(
                f"result.json is written every {least_s:.0f} s instead of {asked_s:g} s, to limit "
                f"its evaluation to {100 * MOST_SHARE:.0f} % of a core; poses are written "
                "immediately; to write results now, call ~/save",
                Level.NOTE,
            )

    def _wake(self) -> None:
        saved, self._saved = self._saved, Future()
        saved.set_result(None)


def _level(trouble: str) -> Level:
    return Level.WARNING if trouble else Level.NOTE
