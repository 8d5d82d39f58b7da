"""The folder of `--output`: result.json, errors of all pairs, and figures."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from trajeval_ros.cli.pictures import PICTURE
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command, pyarrow_command
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.live.state_file import SUFFIX
from trajeval_ros.io.results.error_archive import ARCHIVE, TABLE, error_files
from trajeval_ros.io.writing import collect_leftovers, refused_by_disk, temporary_folder
from trajeval_ros.pipeline.outcome import Outcome
from trajeval_ros.report.canvas import Drawing
from trajeval_ros.report.figure_output import save_all
from trajeval_ros.report.figure_style import FigureStyle

_RESULT, PAGE = "result.json", "report.html"
_HEAD = 64  # bytes with the schema
_OURS = re.compile(
    "(trajectory_(top|side)|(absolute|relative)_error|groundtruth_uncertainty|mahalanobis"
    r"|likelihood_by_edge|(as_available|consistency|uncertainty_top|stanford)(_\d+)?)(-img\d+)?\.(png|pdf|svg|pgf)|report\.html"
)
_HAVE_FIGURES = find_spec("matplotlib") is not None
_HAVE_PAGES = find_spec("jinja2") is not None


def write_folder(
    folder: Path,
    result: dict[str, object],
    outcome: Outcome,
    look: FigureStyle,
    command: str = "",
) -> None:
    """Write all files under temporary names first; the folder never has partial files.

    result.json is removed first and written last: if it exists, all files are from one evaluation.
    `command`: the command that the page states.
    """
    with refused_by_disk(f"the folder {folder}"):
        _write(folder, result, outcome, look, command)


def _write(
    folder: Path, result: dict[str, object], outcome: Outcome, look: FigureStyle, command: str
) -> None:
    is_own = _is_own(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    # An existing folder may be a mount point, and the only writable place.
    parent = folder if folder.is_dir() else folder.parent
    # A first run that was killed has left temporary files next to the folder.
    collect_leftovers(folder.parent)
    with temporary_folder(folder.name, parent) as temporary, ThreadPoolExecutor(1) as thread:
        # For long runs, the arrays take as long as the figures.
        writing = [
            thread.submit(write, temporary / name) for name, write in error_files(outcome).items()
        ]
        try:
            drawings: dict[str, Drawing] = {}
            if _HAVE_FIGURES:
                from trajeval_ros.report.figures import outcome_drawings

                drawings = outcome_drawings(outcome)
                save_all(drawings, temporary, look)
            if _HAVE_PAGES:
                from trajeval_ros.report.evaluation_page import evaluation_page

                page = evaluation_page(outcome, drawings, command)
                (temporary / PAGE).write_text(page, encoding="utf-8")
        finally:  # of two errors, such as of a full disk, that of the arrays is reported
            for task in writing:
                task.result()
        (temporary / _RESULT).write_text(json_text(result, indent=2), encoding="utf-8")
        folder.mkdir(exist_ok=True)
        (folder / _RESULT).unlink(missing_ok=True)
        # Remove files of an earlier evaluation.
        (folder / TABLE).unlink(missing_ok=True)
        # In the folder of a live run, the node wrote the picture.
        if is_own and not any(folder.glob(f"*{SUFFIX}")):
            (folder / PICTURE).unlink(missing_ok=True)
        for old in folder.iterdir():
            if _OURS.fullmatch(old.name):
                old.unlink()
        # The archive is the first and identifies the folder if the process is killed.
        order = {ARCHIVE: 0, _RESULT: 2}
        for file in sorted(temporary.iterdir(), key=lambda file: order.get(file.name, 1)):
            file.replace(folder / file.name)


def _is_own(folder: Path) -> bool:
    """Return whether a folder has results, which are replaced; raise InputError if others do."""
    for name, mark in ((_RESULT, b'"schema": "trajeval/'), (ARCHIVE, b"schema.npy")):
        path = folder / name
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as file:
                start = file.read(_HEAD)
            if start and mark not in start:
                raise _foreign(path)
            return True
    if any(folder.glob(f"*{SUFFIX}")):
        return True
    for path in folder.iterdir() if folder.is_dir() else ():
        is_result = path.name == TABLE or _OURS.fullmatch(path.name)
        if is_result and not path.is_symlink():  # a link is replaced, its target is not
            raise _foreign(path)
    return False


def _foreign(path: Path) -> InputError:
    return InputError(
        f"{path} is not from an evaluation, which replaces it; choose another --output, or "
        "move it away"
    )


def contents(folder: Path) -> str:
    """Return the folder's contents, and which package optional contents need."""
    files, hints = [_RESULT, ARCHIVE], []
    if _HAVE_PAGES:
        files.insert(0, PAGE)
    else:
        hints.append(f"{PAGE} needs Jinja2, install it: {extra_command('plot')}")
    if (folder / TABLE).exists():
        files.append(TABLE)
    else:
        hints.append(f"{TABLE} needs pyarrow, install it: {pyarrow_command()}")
    if _HAVE_FIGURES:
        files.append("figures")
    else:
        hints.append(f"figures need matplotlib, install it: {extra_command('plot')}")
    sentence = f"{', '.join(files[:-1])} and {files[-1]} are in {folder}"
    return "; ".join([sentence, *hints])
