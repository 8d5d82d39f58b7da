"""Search for bags and trajectory files below a folder."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.text.reader import layout_in

DEEPEST, MOST = 4, 200  # limits: levels of subfolders, listed sources
_MOST_FILES = 20_000  # limit of examined files
_PX4_BYTES = 4 << 20  # examined bytes of a log; PX4 announces most topics at its start
_BAGS = {".mcap": "MCAP", ".db3": "rosbag2 sqlite3", ".bag": "ROS 1 bag"}
_TEXTS = {".txt", ".csv", ".tum", ".kitti", ".dat", ".log", ".tsv", ""}


@dataclass(frozen=True)
class FoundSource:
    """A bag or a file with a trajectory."""

    path: Path  # path, starting with the searched folder
    kind: str  # format
    topics: tuple[str, ...] = ()  # topics of a bag that contain poses or transforms
    problem: str = ""  # reason why it can't be opened, "" if it can


@dataclass(frozen=True)
class FolderContents:
    """Result of a search below a folder."""

    sources: tuple[FoundSource, ...]  # found sources, sorted by path
    others: int  # number of files without a trajectory
    left_out: tuple[str, ...]  # descriptions of the files and folders that were not examined


def find_sources(
    folder: Path, advance: Callable[[int, int], None] = lambda done, total: None
) -> FolderContents:
    """Return the bags and trajectory files below a folder, down to `DEEPEST` levels.

    `folder`: existing folder. Hidden subfolders and links to folders are not entered. `advance`:
    progress callback, called with the number of files done and their total.

    Raises:
        InputError: It is the folder of a live run, which has another verb.
    """
    left_out: list[str] = []
    candidates: list[Path] = []
    for path in _walk(folder, left_out):
        if len(candidates) == _MOST_FILES:
            left_out.append(f"files after the first {_MOST_FILES}")
            break
        candidates.append(path)
    sources: list[FoundSource] = []
    others = 0
    for place, path in enumerate(sorted(candidates)):
        if len(sources) == MOST:
            left_out.append(f"{len(candidates) - place} files after the first {MOST} sources")
            break
        source = _recognised(path)
        advance(place, len(candidates))
        if source is None:
            others += 1
        else:
            sources.append(source)
    if not sources:
        _refuse_live_run(folder)
    return FolderContents(tuple(sources), others, tuple(left_out))


def _refuse_live_run(folder: Path) -> None:
    from trajeval_ros.io.live.state_file import GROUNDTRUTH

    if (folder / GROUNDTRUTH).is_file():
        raise InputError(
            f"{folder} is the folder of a live run; evaluate it: "
            f"trajeval finish {shlex.quote(str(folder))}"
        )


def _walk(folder: Path, left_out: list[str]) -> Iterator[Path]:
    """Yield files, and folders that are bags; add a description of skipped ones to `left_out`."""
    too_deep = 0
    for place, folders, files in os.walk(folder):
        here = Path(place)
        if "metadata.yaml" in files:
            folders.clear()
            yield here
            continue
        folders[:] = sorted(item for item in folders if not item.startswith("."))
        if len(here.relative_to(folder).parts) == DEEPEST:
            too_deep += len(folders)
            folders.clear()
        yield from (here / file for file in sorted(files) if not file.startswith("."))
    if too_deep:
        left_out.append(f"{counted(too_deep, 'folder')} more than {DEEPEST} levels deep")


def _recognised(path: Path) -> FoundSource | None:
    """Return the source in a file or in a bag's folder; None if it has no trajectory."""
    kind = ""
    try:
        if path.is_dir() or path.name.removesuffix(".zstd").endswith(tuple(_BAGS)):
            from trajeval_ros.io.bags.bag import Bag

            ending = Path(path.name.removesuffix(".zstd")).suffix
            kind = "rosbag2" if path.is_dir() else _BAGS[ending]
            with Bag(path, None) as bag:
                topics = [topic.name for topic in bag.topics if topic.holds_poses and topic.count]
                topics += [topic.name for topic in bag.topics if topic.holds_transforms]
            return FoundSource(path, kind, tuple(topics))
        if path.suffix.lower() == ".ulg":
            from trajeval_ros.io.ulog import PoseLog

            kind = "PX4 log"
            if path.stat().st_size > _PX4_BYTES:
                kind += f", first {_PX4_BYTES >> 20} MB"
            return FoundSource(path, kind, tuple(PoseLog(path, limit=_PX4_BYTES).topics))
    except (InputError, OSError) as error:
        return FoundSource(path, kind, problem=str(error))
    if path.suffix.lower() not in _TEXTS or not path.is_file():
        return None
    try:
        return FoundSource(path, layout_in(path).name)
    except (InputError, OSError):
        return None
