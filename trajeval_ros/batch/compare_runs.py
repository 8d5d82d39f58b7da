"""A comparison as a whole: from a YAML file or a folder to tables and a report."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.comparison_summary import ComparisonSummary, failures, summary_of
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.executors import local_pool
from trajeval_ros.batch.output_lock import only_writer
from trajeval_ros.batch.record_store import RECORDS
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.exceptions import require_one_of
from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.io.requests.request_words import WORDS
from trajeval_ros.io.writing import write_text
from trajeval_ros.report import matrix as tables


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
    """Evaluate algorithms x sequences x trials, in processes, and write tables and a report.

    A script that calls it does so under `if __name__ == "__main__":`, since processes import it.

    Args:
        target: A YAML file that says what to compare (docs/compare.md), or a folder of ov_eval's
            or rpg_trajectory_evaluation's layout.
        output: Folder for runs.parquet, tables and report.html. What is there and unchanged isn't
            evaluated again.
        columns: What the columns of the estimates' text files are, as in "t x y z qw qx qy qz";
            None for what the file says, or the files themselves.
        frame_rate: Poses a second of text files without stamps; likewise.
        common_time_span: Evaluate only the time that all runs of a sequence have; None for what
            the file says.
        allow_remote: Hosts that the file's URLs may be of, such as `s3://bucket`.
        workers: Number of processes; None for one for each core.
        report: Whether to write report.html, which needs Jinja2.
        **settings: Of the request, by the command line's words with `_` for `-`, such as
            modality="mono-inertial", lengths="8,16" or time_offset="auto"; they override the
            file's.

    Returns:
        All runs, those that failed included, and statistics over trials.

    Raises:
        InputError: The target can't be read, the output can't be written, or a package of the
            extra `compare` is missing; another comparison writes to the same output.
        SettingsError: Settings that mean nothing.

    Example:
        >>> import pathlib, tempfile
        >>> from trajeval_ros import compare
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     compare(pathlib.Path(folder) / "runs.yaml", folder)
        Traceback (most recent call last):
            ...
        trajeval_ros.exceptions.InputError: ...runs.yaml does not exist; give a YAML ...
    """
    for word in settings:
        require_one_of(word, WORDS, "setting")
    folder = Path(output)
    words = {word: _as_written(word, value) for word, value in settings.items()}
    plan = plan_of(
        target,
        words,
        columns=columns,
        frame_rate=frame_rate,
        common_time_span=common_time_span,
        allow_remote=allow_remote,
    )
    with only_writer(folder, RECORDS):
        run_plan(plan, folder, lambda: local_pool(workers))
        summary = summary_of(folder)
        write_tables(folder, summary)
        if report:
            from trajeval_ros.batch.page import write_report

            write_report(folder, summary)
    return summary


def _as_written(word: str, value: str | float) -> str | float:
    """Return a number as the text that its word takes, unless it takes numbers."""
    return str(value) if WORDS[word] is str else value


def write_tables(folder: Path, summary: ComparisonSummary, *, transpose: bool = False) -> None:
    """Write tables.md, tables.tex and a CSV file for each table, those that aren't there yet.

    Args:
        folder: The comparison's.
        summary: What it found.
        transpose: Make the algorithms the columns of tables.tex.

    Raises:
        InputError: They can't be written.
    """
    made = matrices(summary)
    lost = [f"* {markdown_text(line)}" for line in failures(summary)]
    without = ["### Runs without numbers", "", *lost, ""] if lost else []
    title = f"# {markdown_text(summary.title)}"
    text = "\n".join([title, "", *map(tables.to_markdown, made), *without])
    texts = {
        "tables.md": text,
        "tables.tex": "\n".join(tables.to_latex(each, transpose=transpose) for each in made),
        **{f"{each.name}.csv": tables.to_csv(each) for each in made},
    }
    for name, content in texts.items():
        if not _holds(folder / name, content):
            write_text(folder / name, content)


def _holds(path: Path, text: str) -> bool:
    try:
        return path.read_bytes() == text.encode()
    except OSError:
        return False
