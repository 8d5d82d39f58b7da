"""Progress bars, on a terminal only."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trajeval_ros.batch.comparison import Progress as RunProgress
    from trajeval_ros.geometry.trajectory import Trajectory

PATIENCE_S = 1.0


@contextmanager
def progress(description: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function `advance(done, total)`; it prints nothing in a pipe or for quick work."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    from trajeval_ros.formatting.escaping import visible

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task(escape(visible(description)), total=None, visible=True)
    begin = time.monotonic()

    def advance(done: int, total: int) -> None:
        if time.monotonic() - begin > PATIENCE_S:
            bar.start()
            bar.update(task, completed=done, total=total)

    try:
        yield advance
    finally:
        bar.stop()


def read_shown(sources: Sequence[str], names: Sequence[str], **options: Any) -> list[Trajectory]:
    """Read named SOURCEs with a progress bar; the options are those of `read_many`."""
    from trajeval_ros.io.sources import read_many

    with progress(f"reading {', '.join(names)}") as advance:
        read = read_many(sources, advance=advance, **options)
    return [
        dataclasses.replace(trajectory, name=name)
        for trajectory, name in zip(read, names, strict=True)
    ]


def report_dropped(trajectories: Iterable[Trajectory]) -> None:
    """Print on stderr how many poses of each source the reader dropped, and why."""
    from trajeval_ros.geometry.valid_poses import dropped_in_words
    from trajeval_ros.report.console import WARNING, console

    terminal = console(sys.stderr)
    for trajectory in trajectories:
        text = dropped_in_words(trajectory.reading.dropped, len(trajectory))
        if text:
            terminal.remark(WARNING, f"{trajectory.reading.source}: {text}")


@contextmanager
def progress_of_runs() -> Iterator[Callable[[RunProgress], None]]:
    """Yield a function that shows the numbers of finished, failed and running evaluations."""
    if not sys.stderr.isatty():
        yield lambda progress: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    from trajeval_ros.formatting.escaping import visible

    columns: list[Any] = [
        MofNCompleteColumn(),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}[dim]{task.fields[running]}"),
    ]
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        line = bar.add_task("runs", total=None, failed="", running="reading inputs")

        def report(progress: RunProgress) -> None:
            bar.update(
                line,
                total=progress.total or None,
                completed=progress.kept + progress.done + progress.failed,
                failed=f"[red]{progress.failed} failed[/] " if progress.failed else "",
                running=escape(visible(", ".join(progress.running))),
            )

        yield report
