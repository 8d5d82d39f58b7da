"""Reading of the trajectory of a SOURCE: `PATH`, `BAG:TOPIC` or `BAG:/tf:PARENT.CHILD`.

A log of PX4 (.ulg) is read as a bag: `LOG.ulg:TOPIC`.

The format of a file is detected from its content. Text is also read from a pipe, such as a
shell's `<(COMMAND)`, and from stdin, written `-`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.formatting.escaping import SECRET
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.valid_poses import dropped_in_words
from trajeval_ros.io.text.hints import NO_HINTS, TextHints
from trajeval_ros.io.text.reader import read_text

Advance = Callable[[int, int], None]

_AT_ONCE = 1 << 23  # bytes per request to a store
_HEAD = 16  # bytes at the start of a file from which its format is detected
_BAG_BEGINNINGS = (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V")
_ULOG = b"ULog\x01\x12\x35"
_ZSTD = b"\x28\xb5\x2f\xfd"
_URL = re.compile(r"[a-z][a-z0-9+.-]*://")
# Other schemes have an @ in valid addresses: abfs://CONTAINER@ACCOUNT, github://OWNER:NAME@BRANCH.
_WITHOUT_USER = ("http", "https", "s3", "gs", "gcs")
BAG_ENDINGS = (".mcap", ".db3", ".bag")
_PACKED_TEXTS = tuple(
    f"{ending}{packed}"
    for ending in (".txt", ".csv", ".tum", ".tsv")
    for packed in (".zst", ".zstd")
)
STDIN = "-"  # the SOURCE for stdin
_STDIN_PATH = "/dev/stdin"
_PARTS = 1000  # progress steps per file, if there are several files


@dataclass(frozen=True)
class Source:
    """The parts of a SOURCE."""

    path: Path  # a file, or the directory of a rosbag2
    topic: str  # topic with its leading slash, "" if none is given
    frames: tuple[str, str] | None  # (parent, child) of a transform, or None
    is_bag: bool  # whether the path is a bag
    is_pipe: bool = False  # whether the path is a pipe, which can be read only once
    is_log: bool = False  # whether the path is a log of PX4


def read_trajectory(
    source: str | Path,
    *,
    advance: Advance | None = None,
    covariances: bool = True,
    strict: bool = False,
    hints: TextHints = NO_HINTS,
    received: str = "",
) -> Trajectory:
    r"""Read the trajectory that a SOURCE names.

    Args:
        source: `PATH` of a text file or of a bag with one topic of poses, `BAG:TOPIC`,
            `BAG:/tf:PARENT.CHILD`, or `-` for text on stdin.
        advance: Progress callback, called with the amount done and the total: bytes of a text,
            messages of a bag.
        covariances: Whether to read the covariances of a bag.
        strict: Whether to verify all data that is read from a bag, and to refuse a damaged bag,
            and any source with poses that are damaged.
        hints: Columns and frame rate of a text file, as the user states them.
        received: Whether to read the poses of a bag as they were received; see `read_many`.

    Raises:
        InputError: The source can't be read; the message states where, what and what to do.

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
        [source],
        advance=advance,
        covariances=covariances,
        strict=strict,
        hints=hints,
        received=received,
    )
    return trajectory


def read_many(
    sources: Sequence[str | Path],
    *,
    advance: Advance | None = None,
    covariances: bool | Sequence[bool] = True,
    strict: bool = False,
    hints: TextHints | Sequence[TextHints] = NO_HINTS,
    received: str = "",
) -> list[Trajectory]:
    r"""Read the trajectories of several SOURCEs; a bag with several of them is read once.

    The result for a source is the same as if it is read alone, including remarks.

    Args:
        sources: SOURCEs as for `read_trajectory`.
        advance: Progress callback, called with the amount done and the total. For one source or
            one bag as for `read_trajectory`; otherwise all files and bags have equal weight.
        covariances: Whether to read the covariances of a bag; one value, or one per source.
        strict: Whether to verify all data that is read from a bag, and to refuse a damaged bag,
            and any source with poses that are damaged.
        hints: Columns and frame rate of text files; one value, or one per source.
        received: Whether to read the poses of a bag as they were received, and by which clock:
            `log`, `publish`, or `auto` for publish times where they differ; empty for no.

    Returns:
        One trajectory per source, in the same order. `reading.source` is the SOURCE.

    Raises:
        InputError: A source can't be read; the message states where, what and what to do. All
            paths are checked before the first file is read.
        ValueError: The number of `covariances` or `hints` is not the number of sources.

    Example:
        >>> import pathlib, tempfile
        >>> from trajeval_ros import read_many
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "run.txt"
        ...     _ = path.write_text("1.0 0 0 0 0 0 0 1\n1.5 2 0 0 0 0 0 1\n")
        ...     [len(each) for each in read_many([path, path])]
        [2, 2]
    """
    for source in sources:
        if not isinstance(source, str | Path):
            raise InputError(
                f"a source is a path or BAG:TOPIC, not {type(source).__name__}; for arrays and "
                "tables, use Trajectory.from_matrices, from_positions or from_pandas"
            )
    parsed = [parse_source(str(source)) for source in sources]
    flags = [covariances] * len(parsed) if isinstance(covariances, bool) else list(covariances)
    known = [hints] * len(parsed) if isinstance(hints, TextHints) else list(hints)
    for what, values in (("covariances", flags), ("hints", known)):
        if len(values) != len(parsed):
            raise ValueError(
                f"{what}: {counted(len(values), 'value')} for "
                f"{counted(len(parsed), 'source')}; give one value per source"
            )
    files: dict[object, list[int]] = {}  # indices of the sources, by file or bag
    for number, parts in enumerate(parsed):
        # A pipe can be read only once: all its sources are one entry, whatever their hints.
        name: object = (str(parts.path), NO_HINTS if parts.is_pipe else known[number])
        if parts.is_bag or parts.is_log:  # a bag can have several spellings
            is_local = isinstance(parts.path, Path)
            name = os.path.realpath(parts.path) if is_local else str(parts.path)
        files.setdefault(name, []).append(number)
    read: dict[int, Trajectory] = {}
    for done, numbers in enumerate(files.values()):
        first, part_advance = parsed[numbers[0]], _part_of(advance, done, len(files))
        with _naming(first.path):
            if first.is_pipe and len(numbers) > 1:
                raise InputError("a pipe can be read only once; use it for one source")
            if first.is_log:
                from trajeval_ros.io.ulog import read_log

                logged = read_log(
                    first.path, [parsed[item].topic for item in numbers], strict=strict
                )
                read |= zip(numbers, logged, strict=True)
                continue
            if not first.is_bag:
                with _local_file(first.path) as file:
                    if first.is_pipe and _begins_as_bag(file, _beginning_of(file)):
                        raise InputError("a bag can't be read from a pipe; give the file")
                    text = read_text(file, part_advance, known[numbers[0]], beside=first.path)
                read |= dict.fromkeys(numbers, text)
                continue
            from trajeval_ros.io.bags.topics import BagSource, read_bag

            requested = [
                BagSource(parsed[item].topic, parsed[item].frames, flags[item], received)
                for item in numbers
            ]
            trajectories = read_bag(first.path, requested, part_advance, strict=strict)
            read |= zip(numbers, trajectories, strict=True)
    trajectories_read = []
    for number, source in enumerate(sources):
        reading = dataclasses.replace(read[number].reading, source=str(source))
        trajectories_read.append(dataclasses.replace(read[number], reading=reading))
        lost = dropped_in_words(reading.dropped, len(read[number]), all_reasons=False)
        if strict and lost:
            raise InputError(f"{source}: {lost}; correct them, or remove --strict")
    return trajectories_read


def each_topic(source: str) -> list[str]:
    """Return the source itself, or for a bag without a topic one source per topic with poses."""
    parts = parse_source(source)
    if parts.is_log and not parts.topic:
        from trajeval_ros.io.ulog import topics_of

        return [f"{source}:{topic}" for topic in topics_of(parts.path)] or [source]
    if not parts.is_bag or parts.topic:
        return [source]
    from trajeval_ros.io.bags.bag import Bag

    with _naming(parts.path), Bag(parts.path, None) as bag:
        topics = [topic.name for topic in bag.topics if topic.holds_poses and topic.count]
    return [f"{source}:{topic}" for topic in topics] or [source]


def _part_of(advance: Advance | None, done: int, count: int) -> Advance | None:
    """Return the progress callback for one of `count` files, of which `done` are complete."""
    if advance is None or count == 1:
        return advance

    def part(own_done: int, own_total: int) -> None:
        advance(_PARTS * done + _PARTS * own_done // max(own_total, 1), _PARTS * count)

    return part


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Add the path to the message of an error in the block, if it is missing."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from error


def parse_source(source: str) -> Source:
    """Return the parts of a SOURCE.

    A path may contain colons. The longest existing path at the start of the SOURCE is taken.
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
        beginning = _beginning_of(path) if path.is_file() else b""
        is_log = beginning.startswith(_ULOG)
        is_bag = _begins_as_bag(path, beginning) if path.is_file() else not _holds_poses(path)
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    if not rest or is_log:
        return Source(path, rest, None, is_bag, is_log=is_log)
    if not is_bag:
        raise InputError(f"{path} is not a bag and has no topic {rest}; give only the file")
    topic, _, frames = rest.partition(":")
    topic = "/" + topic.lstrip("/")
    if not frames and topic not in ("/tf", "/tf_static"):
        return Source(path, topic, None, is_bag)
    return Source(path, topic, _parse_frames(topic, frames), is_bag)


def _split_url(source: str) -> tuple[Path, str]:
    """Return the longest existing URL at the start of a source, and the text after its colon."""
    require_no_password(source)
    try:
        from upath import UPath
    except ImportError as error:
        raise InputError(f"URLs need an extra; install it: {extra_command('remote')}") from error
    pieces = source.split(":")
    try:
        for count in range(len(pieces), 1, -1):
            url = ":".join(pieces[:count])
            path: Any = UPath(url)  # has the methods of Path that are used here
            if path.exists():
                return path, ":".join(pieces[count:])
    except Exception as error:  # the types of exceptions depend on the store
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{source} can't be reached: {reason}") from error
    raise InputError(f"{source} does not exist; check the URL")


def _split_path(source: str) -> tuple[Path, str]:
    """Return the longest existing path at the start of a source, and the text after its colon."""
    pieces = source.split(":")
    for count in range(len(pieces), 0, -1):
        path = Path(":".join(pieces[:count]))
        try:
            if path.exists():
                return path, ":".join(pieces[count:])
        except (OSError, ValueError):  # the name is too long or contains a zero byte
            continue
    missing = Path(pieces[0])
    raise InputError(f"{missing} does not exist{_nearest_name(missing)}")


def _nearest_name(missing: Path) -> str:
    """Return the end of a message: the file with the most similar name in the same directory."""
    try:
        names = [entry.name for entry in missing.parent.iterdir() if entry.name != missing.name]
    except PermissionError:
        return f", or the folder {missing.parent} can't be read; check its permissions"
    except OSError:
        return f", nor does the folder {missing.parent}"
    near = difflib.get_close_matches(missing.name, names, n=1)
    return f"; did you mean {missing.with_name(near[0])}?" if near else "; check the path"


def _begins_as_bag(path: Path, beginning: bytes) -> bool:
    """Return whether a file is a bag of any format, from its first bytes."""
    if not beginning and path.suffix in BAG_ENDINGS:
        raise InputError(f"{path} is empty; check that the recording has data")
    is_packed = beginning.startswith(_ZSTD)  # text is read by its own reader
    return beginning.startswith(_BAG_BEGINNINGS) or (
        is_packed and not path.name.endswith(_PACKED_TEXTS)
    )


def _holds_poses(folder: Any) -> bool:
    """Return whether a folder has one text file per pose, and no bag."""
    if not isinstance(folder, Path) or (folder / "metadata.yaml").exists():
        return False
    names = [path.name for path in folder.iterdir()]
    return any(name.endswith(".txt") for name in names) and not any(
        name.removesuffix(".zstd").endswith(BAG_ENDINGS) for name in names
    )


def _beginning_of(path: Any) -> bytes:
    """Return the first bytes of a path of this machine, or of universal_pathlib."""
    if isinstance(path, Path):
        with path.open("rb") as file:
            return file.read(_HEAD)
    from trajeval_ros.io.bags.byte_source import source_of

    return source_of(path).read(0, _HEAD)  # an open file would fetch megabytes ahead


@contextlib.contextmanager
def _local_file(path: Any) -> Iterator[Path]:
    """Yield a local file as it is, or a temporary copy of a pipe or of a remote object.

    Messages about the copy name the original.
    """
    if isinstance(path, Path) and (path.is_file() or path.is_dir()):
        yield path
        return
    from trajeval_ros.io.writing import temporary_folder

    with temporary_folder("copy") as folder:
        copy = folder / path.name
        with copy.open("wb") as writing:
            if isinstance(path, Path):
                with path.open("rb") as reading:
                    shutil.copyfileobj(reading, writing)
            else:
                _download(path, writing)
        try:
            yield copy
        except InputError as error:
            raise InputError(str(error).replace(str(copy), str(path))) from error


def _download(path: Any, writing: BinaryIO) -> None:
    from trajeval_ros.io.bags.byte_source import source_of

    source = source_of(path)
    for offset in range(0, source.size, _AT_ONCE):
        writing.write(source.read(offset, _AT_ONCE))


def _parse_frames(topic: str, frames: str) -> tuple[str, str]:
    """Return (parent, child) of `PARENT.CHILD`, without leading and trailing slashes."""
    parent, dot, child = frames.partition(".")
    parent, child = parent.strip("/"), child.strip("/")
    if not (parent and dot and child):
        raise InputError(
            f"{topic} has transforms between many frames; give two as in "
            f"BAG:{topic}:PARENT.CHILD, such as {topic}:map.base_link (list them with "
            "`trajeval info BAG`)"
        )
    return parent, child


def require_no_password(url: str) -> None:
    """Check that a URL has no password or token, since results, tables and logs repeat the URL."""
    for word in url.split("::"):  # a chain of URLs
        scheme, _, rest = word.lower().partition("://")
        user, at, host = re.split(r"[/?#]", rest, maxsplit=1)[0].rpartition("@")
        if SECRET.search(rest):
            raise InputError(
                f"{scheme}://{host} has a secret in its query, which results and logs repeat; "
                "download the file first"
            )
        if at and (scheme in _WITHOUT_USER or (":" in user and scheme != "github")):
            raise InputError(
                f"{scheme}://{host} has a user name or password, which results and logs repeat; "
                "set it in the environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
            )
