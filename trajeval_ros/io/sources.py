"""SOURCE -> Trajectory: `PATH`, `BAG:TOPIC` or `BAG:/tf:PARENT.CHILD`, recognised by content.

A text may also come through a pipe, such as a shell's `<(COMMAND)`, or as `-` on stdin.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.byte_source import beginning_of
from trajeval_ros.io.local_copy import local_file
from trajeval_ros.io.text.hints import NO_HINTS, TextHints
from trajeval_ros.io.text.reader import read_text
from trajeval_ros.io.urls import require_no_password

Advance = Callable[[int, int], None]

_HEAD = 16  # bytes that tell what a file is
_BAG_BEGINNINGS = (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V")
_ZSTD = b"\x28\xb5\x2f\xfd"
_URL = re.compile(r"[a-z][a-z0-9+.-]*://")
_BAG_ENDINGS = (".mcap", ".db3", ".bag")
STDIN = "-"  # what names it among sources
_STDIN_PATH = "/dev/stdin"
_PARTS = 1000  # that each of several files counts in the progress


@dataclass(frozen=True)
class Source:
    """A source, taken apart.

    Attributes:
        path: A file, or the directory of a rosbag2.
        topic: Topic with its leading slash, "" if none was given.
        frames: (parent, child) of a transform, or None.
        is_bag: Whether the path holds a bag.
        is_pipe: Whether it can be read only once, from its beginning to its end.
    """

    path: Path
    topic: str
    frames: tuple[str, str] | None
    is_bag: bool
    is_pipe: bool = False


def read_trajectory(
    source: str | Path,
    *,
    advance: Advance | None = None,
    covariances: bool = True,
    strict: bool = False,
    hints: TextHints = NO_HINTS,
) -> Trajectory:
    r"""Read the trajectory that a SOURCE names.

    Args:
        source: `PATH` of a text file or of a bag with one topic of poses, `BAG:TOPIC`,
            `BAG:/tf:PARENT.CHILD`, or `-` for text on stdin.
        advance: Called with what is done and with all there is (bytes of a text, messages of a
            bag), now and then.
        covariances: Whether to read those of a bag, too.
        strict: Whether to verify all that is read of a bag, and to refuse it if it is damaged.
        hints: What is known of a text file beyond what is in it.

    Raises:
        InputError: It can't be read; the message says what is wrong, where, and how to mend it.

    Example:
        >>> import pathlib, tempfile
        >>> from trajeval_ros import read_trajectory
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "run.txt"
        ...     _ = path.write_text("1.0 0 0 0 0 0 0 1\n1.5 2 0 0 0 0 0 1\n")
        ...     read_trajectory(path)
        <Trajectory run, 2 poses, 0.5 s, 2.0 m>
    """
    (trajectory,) = read_many(
        [source], advance=advance, covariances=covariances, strict=strict, hints=hints
    )
    return trajectory


def read_many(
    sources: Sequence[str | Path],
    *,
    advance: Advance | None = None,
    covariances: bool | Sequence[bool] = True,
    strict: bool = False,
    hints: TextHints | Sequence[TextHints] = NO_HINTS,
) -> list[Trajectory]:
    r"""Read the trajectories that several SOURCEs name; each bag once, however many are in it.

    A trajectory, its notes and its damage are the same as if its source were read alone.

    Args:
        sources: Each as for `read_trajectory`.
        advance: Called with what is done and with all there is, now and then. For one source or
            one bag as for `read_trajectory`; otherwise each file or bag counts the same.
        covariances: Whether to read those of a bag, too; for all sources, or for each.
        strict: Whether to verify all that is read of a bag, and to refuse it if it is damaged.
        hints: What is known of text files beyond what is in them; of all, or of each.

    Returns:
        A trajectory for each source, in their order, which names it.

    Raises:
        InputError: One can't be read; the message says which, what is wrong, and how to mend it.
            That each exists is checked before any is read.

    Example:
        >>> import pathlib, tempfile
        >>> from trajeval_ros import read_many
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "run.txt"
        ...     _ = path.write_text("1.0 0 0 0 0 0 0 1\n1.5 2 0 0 0 0 0 1\n")
        ...     [len(each) for each in read_many([path, path])]
        [2, 2]
    """
    parsed = [parse_source(str(source)) for source in sources]
    flags = [covariances] * len(parsed) if isinstance(covariances, bool) else list(covariances)
    known = [hints] * len(parsed) if isinstance(hints, TextHints) else list(hints)
    for what, values in (("covariances", flags), ("hints", known)):
        if len(values) != len(parsed):
            raise ValueError(
                f"{what}: {counted(len(values), 'value')} for "
                f"{counted(len(parsed), 'source')}; give one value per source"
            )
    files: dict[object, list[int]] = {}  # numbers of the sources of each file or bag
    for number, parts in enumerate(parsed):
        # A pipe can be read once, whatever is known of it.
        own_hints = NO_HINTS if parts.is_pipe else known[number]
        name = _same_bag(parts.path) if parts.is_bag else (str(parts.path), own_hints)
        files.setdefault(name, []).append(number)
    read: dict[int, Trajectory] = {}
    for done, numbers in enumerate(files.values()):
        first, own = parsed[numbers[0]], _part_of(advance, done, len(files))
        with _naming(first.path):
            if first.is_pipe and len(numbers) > 1:
                raise InputError("a pipe can be read only once; use it for one source")
            if not first.is_bag:
                with local_file(first.path) as file:
                    if first.is_pipe and _begins_as_bag(file):
                        raise InputError("a bag can't be read from a pipe; give the file")
                    text = read_text(file, own, known[numbers[0]], beside=first.path)
                read |= dict.fromkeys(numbers, text)
                continue
            from trajeval_ros.io.bags.topics import BagSource, read_bag

            wanted = [
                BagSource(parsed[each].topic, parsed[each].frames, flags[each]) for each in numbers
            ]
            trajectories = read_bag(first.path, wanted, own, strict=strict)
            read |= zip(numbers, trajectories, strict=True)
    return [
        dataclasses.replace(read[number], source=str(source))
        for number, source in enumerate(sources)
    ]


def each_topic(source: str) -> list[str]:
    """Return a source, or for a bag without a topic one source for each topic with poses.

    Raises:
        InputError: There is no such file, or no such topic in the bag.
    """
    parts = parse_source(source)
    if not parts.is_bag or parts.topic:
        return [source]
    from trajeval_ros.io.bags.bag import Bag

    with _naming(parts.path), Bag(parts.path, None) as bag:
        topics = [topic.name for topic in bag.topics if topic.holds_poses and topic.count]
    return [f"{source}:{topic}" for topic in topics] or [source]


def _same_bag(path: Any) -> str:
    """Return a name that is the same however the path of a bag is spelled."""
    return os.path.realpath(path) if isinstance(path, Path) else str(path)


def _part_of(advance: Advance | None, done: int, count: int) -> Advance | None:
    """Return what tells the progress of one of several files, given how many are done."""
    if advance is None or count == 1:
        return advance

    def part(own_done: int, own_total: int) -> None:
        advance(_PARTS * done + _PARTS * own_done // max(own_total, 1), _PARTS * count)

    return part


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """See to it that an error says which file it is about."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path} can't be read: {error.strerror or error}") from error
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from error


def parse_source(source: str) -> Source:
    """Take a SOURCE apart; the part before a colon is the path as soon as that exists.

    Raises:
        InputError: There is no such file or directory, or the frames aren't `PARENT.CHILD`.
    """
    if not source:
        raise InputError("a source is empty; give a file or BAG:TOPIC")
    source = _STDIN_PATH if source == STDIN else source
    path, rest = _split_url(source) if _URL.match(source) else _split_path(source)
    try:
        if not (path.is_file() or path.is_dir()):
            if not path.is_fifo():
                raise InputError(f"{path} is a device; give a file or a pipe")
            return Source(path, rest, None, is_bag=False, is_pipe=True)
        is_bag = path.is_dir() or _begins_as_bag(path)
    except OSError as error:
        raise InputError(f"{path} can't be read: {error.strerror or error}") from error
    if not rest:
        return Source(path, "", None, is_bag)
    if not is_bag:
        raise InputError(f"{path} is not a bag and has no topic {rest}; give only the file")
    topic, _, frames = rest.partition(":")
    topic = "/" + topic.lstrip("/")
    if not frames and topic not in ("/tf", "/tf_static"):
        return Source(path, topic, None, is_bag)
    return Source(path, topic, _parse_frames(topic, frames), is_bag)


def _split_url(source: str) -> tuple[Path, str]:
    """Return the existing object that a source begins with, and what follows its colon."""
    require_no_password(source)
    try:
        from upath import UPath
    except ImportError as error:
        raise InputError(f"URLs need an extra; install it: {extra_command('remote')}") from error
    pieces = source.split(":")
    try:
        for count in range(len(pieces), 1, -1):
            url = ":".join(pieces[:count])
            path: Any = UPath(url)  # a Path in all that is asked of it
            if path.exists():
                return path, ":".join(pieces[count:])
    except Exception as error:  # each kind of store has its own
        said = " ".join(str(error).split())[:200]
        raise InputError(f"{source} can't be reached: {said}") from error
    raise InputError(f"{source} does not exist; check the URL")


def _split_path(source: str) -> tuple[Path, str]:
    """Return the existing path that a source begins with, and what follows its colon."""
    pieces = source.split(":")
    for count in range(len(pieces), 0, -1):
        path = Path(":".join(pieces[:count]))
        try:
            if path.exists():
                return path, ":".join(pieces[count:])
        except (OSError, ValueError):  # a name too long, a zero byte
            continue
    missing = Path(pieces[0])
    raise InputError(f"{missing} does not exist{_nearest_name(missing)}")


def _nearest_name(missing: Path) -> str:
    """Return what to say about the file in the same directory that has the nearest name."""
    try:
        names = [entry.name for entry in missing.parent.iterdir()]
    except OSError:
        return f", nor does the directory {missing.parent}"
    near = difflib.get_close_matches(missing.name, names, n=1)
    return f"; did you mean {missing.with_name(near[0])}?" if near else "; check the path"


def _begins_as_bag(path: Path) -> bool:
    """Return whether a file is a bag of any kind, by its first bytes."""
    beginning = beginning_of(path, _HEAD)
    if not beginning and path.suffix in _BAG_ENDINGS:
        raise InputError(f"{path} is empty; check that the recording has data")
    return beginning.startswith((*_BAG_BEGINNINGS, _ZSTD))


def _parse_frames(topic: str, frames: str) -> tuple[str, str]:
    """Return parent and child of `PARENT.CHILD`."""
    parent, dot, child = frames.partition(".")
    parent, child = parent.strip("/"), child.strip("/")
    if not (parent and dot and child):
        raise InputError(
            f"{topic} has transforms between many frames; give two as in "
            f"BAG:{topic}:PARENT.CHILD, such as {topic}:map.base_link (list them with "
            "`trajeval info BAG`)"
        )
    return parent, child
