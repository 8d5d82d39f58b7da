"""A whole comparison: from a YAML file, a manifest or a folder to tables and a report.

One comparison at a time writes to an output folder, on this machine or another.
"""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.comparison_summary import (
    ComparisonSummary,
    dropped_poses,
    failures,
    summary_of,
)
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.executors import local_pool
from trajeval_ros.batch.finished_comparison import FIGURES, PAGES, require_own
from trajeval_ros.batch.records import RECORDS
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.formatting.escaping import markdown_text, one_line
from trajeval_ros.io.requests.settings_table import settings_of_many_runs
from trajeval_ros.io.writing import collect_leftovers, is_at, lock, refused_by_disk, write_text
from trajeval_ros.report import matrix as tables

LOCK = ".compare.lock"
_MOST_READ = 200


def compare(
    target: str | Path,
    output: str | Path,
    *,
    columns: str | None = None,
    frame_rate: float | None = None,
    common_time_span: bool | None = None,
    allow_remote: Iterable[str] = (),
    workers: int | None = None,
    report: bool = True,
    **settings: str | float,
) -> ComparisonSummary:
    """Evaluate algorithms x sequences x trials in processes; write tables and a report.

    Call it under `if __name__ == "__main__":`, because the processes import the script.

    Args:
        target: A YAML file, a manifest (docs/compare.md), or a folder in the layout of ov_eval or
            rpg_trajectory_evaluation.
        output: Folder for runs.parquet, tables and report.html. Finished runs in it that are
            unchanged are not evaluated again.
        columns: Columns of the estimates' text files, as in "t x y z qw qx qy qz"; None for those
            of the YAML file or of the text files.
        frame_rate: Poses per second in text files without timestamps; None for that of the YAML
            file.
        common_time_span: Whether to evaluate only the time that all runs of a sequence cover; None
            for the setting of the file.
        allow_remote: Hosts that URLs in the file may name, such as `s3://bucket`.
        workers: Number of processes; None for one per core.
        report: Whether to write report.html and figures, which need Jinja2 and matplotlib.
        **settings: Settings of the request, as options with `_` for `-`, such as
            modality="mono-inertial", lengths="8,16" or time_offset="auto". They override the file.

    Returns:
        All runs, including failed ones, and statistics over trials.

    Raises:
        InputError: The target can't be read, the output can't be written, a package of the extra
            `compare` is missing, or another comparison writes to the same output.
        SettingsError: A setting is not valid.

    Example:
        >>> import pathlib, tempfile
        >>> from trajeval_ros import compare
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     compare(pathlib.Path(folder) / "runs.yaml", folder)
        Traceback (most recent call last):
            ...
        trajeval_ros.exceptions.InputError: ...runs.yaml does not exist; give a YAML ...
    """
    known = settings_of_many_runs()
    for name in settings:
        require_one_of(name, known, "setting")
    if report:
        from trajeval_ros.batch.comparison_report import write_report
        from trajeval_ros.report.comparison_page import require_jinja2

        require_jinja2()
    folder = Path(output)
    plan = plan_of(
        target,
        {
            **{name: known[name].of_yaml(value) for name, value in settings.items()},
            "columns": columns,
            "frame_rate": frame_rate,
            "common_time_span": common_time_span,
        },
        allow_remote=allow_remote,
    )
    start_pool = partial(local_pool, workers)
    with only_writer(folder):
        run_plan(plan, folder, start_pool)
        summary = summary_of(folder)
        write_tables(folder, summary)
        if report:
            write_report(folder, summary, start_pool)
    return summary


def write_tables(folder: Path, summary: ComparisonSummary, *, transpose: bool = False) -> None:
    """Write tables.md, tables.tex and one CSV file per table, unless they are up to date."""
    made = matrices(summary)
    shown, notes = tables.with_common_notes(made)
    lists = {
        "### Runs with dropped poses": dropped_poses(summary),
        "### Runs without numbers": failures(summary),
    }
    listed: list[str] = []
    for heading, lines in lists.items():
        if lines:
            listed += [heading, "", *(f"* {markdown_text(line)}" for line in lines), ""]
    common = [markdown_text(" ".join(notes)), ""] if notes else []
    title = f"# {markdown_text(summary.title)}"
    text = "\n".join([title, "", *map(tables.to_markdown, shown), *common, *listed])
    texts = {
        "tables.md": text,
        "tables.tex": "\n".join(tables.to_latex(item, transpose=transpose) for item in made),
        **{f"{item.name}.csv": tables.to_csv(item) for item in made},
    }
    for name, content in texts.items():
        if not _holds(folder / name, content):
            write_text(folder / name, content)


def _holds(path: Path, text: str) -> bool:
    try:
        return path.read_bytes() == text.encode()
    except OSError:
        return False


@contextlib.contextmanager
def only_writer(folder: Path, wait: Callable[[str], object] | None = None) -> Iterator[None]:
    """Make a comparison's folders and lock them during the block.

    Unfinished files of killed comparisons are removed, and folders that were made and are still
    empty after the block, as those of a refused comparison. `wait`: called with the holder of the
    lock before waiting for it; None to raise an error instead of waiting.
    """
    records = folder / RECORDS
    for item in (records, folder / FIGURES, folder / PAGES):
        if item.is_symlink():
            raise InputError(f"{item} is a symbolic link; remove it")
    require_own(folder)
    new = [item for item in (records, *records.parents) if not item.exists()]
    path = folder / LOCK
    while True:
        with refused_by_disk(f"the folder {folder}"):
            records.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):  # read-only: only a finished comparison can be shown
            yield
            return
        with refused_by_disk(str(path)):
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            _hold(file, folder, wait)
            if not is_at(path, file):  # its previous holder has removed it
                continue
            with refused_by_disk(str(path)):
                os.truncate(file, 0)
                os.write(file, f"process {os.getpid()} on {platform.node()}".encode())
            for item in (folder, records):
                collect_leftovers(item)
            try:
                yield
            finally:
                with contextlib.suppress(OSError):  # such as a folder with files
                    path.unlink()
                    for item in new:
                        item.rmdir()
            return
        finally:
            os.close(file)


def _hold(file: int, folder: Path, wait: Callable[[str], object] | None) -> None:
    """Lock the open file, or raise an error."""
    with contextlib.suppress(OSError):  # a file system without locks
        if lock(file, wait=False):
            return
        holder = one_line(os.pread(file, _MOST_READ, 0).decode(errors="replace"))
        held = f"{folder} is in use by {holder or 'another process'}"
        if wait is None:
            raise InputError(f"{held}; wait with --wait, or choose another --output")
        wait(held)
        lock(file, wait=True)
