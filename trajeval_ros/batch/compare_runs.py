"""A whole comparison: from a YAML file, a manifest or a folder to tables and a report."""

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
        report: Whether to write report.html, which needs Jinja2.
        **settings: Settings of the request, by the words of the command line with `_` for `-`,
            such as modality="mono-inertial", lengths="8,16" or time_offset="auto". They override
            the file.

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
    """Return a number as text if its setting is a text."""
    return str(value) if WORDS[word] is str else value


def write_tables(folder: Path, summary: ComparisonSummary, *, transpose: bool = False) -> None:
    """Write tables.md, tables.tex and one CSV file per table, unless they are up to date.

    Args:
        folder: Folder of the comparison.
        summary: Its results.
        transpose: Whether algorithms are the columns of tables.tex.

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
