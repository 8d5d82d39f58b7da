"""Files whose poses are not one per line, rewritten as lines of a table.

Graphs of g2o, stacked 4 x 4 matrices, folders of poses, COLMAP, YAML of rostopic and JSON become a
table, so that one reader checks and converts all. Blank lines keep the numbers of lines right.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.text.layouts import CAMERA, MATRIX_4X4, known
from trajeval_ros.io.text.lines import Advance, open_lines
from trajeval_ros.io.text.table import Records, number

_PLANAR = known("g2o", "frame x y yaw", "", "g2o wiki: file format")
_GRAPHS = {  # the last two are of TORO
    "VERTEX_SE3:QUAT": known("g2o", "frame x y z qx qy qz qw", "unit", "g2o wiki: file format"),
    "VERTEX_SE2": _PLANAR,
    "VERTEX3": known("g2o", "frame x y z roll pitch yaw", "", "openslam.org/toro"),
    "VERTEX2": _PLANAR,
}
_TAG = re.compile(rf"(?m)^({'|'.join(_GRAPHS)})\s")
_COLMAP = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
_PICTURE = r"(?i)\.(?:png|jpe?g|bmp|tiff?|p[gp]m|webp)\Z"
_IMAGES = known(
    "COLMAP", "frame qw qx qy qz x y z", "unit", "colmap.github.io: output format",
    inverse=True, up=CAMERA, note="frame numbers from the names of the images",
)  # fmt: skip
_STACKED = known("stacked 4 x 4 matrices", MATRIX_4X4, "matrix bottom", "NICE-SLAM, 7-Scenes")
_LOGGED = known("Open3D log", f"frame _ _ {MATRIX_4X4}", "matrix", "open3d.org: camera trajectory")
_FOLDER = known("folder of 4 x 4 matrices", f"frame {MATRIX_4X4}", "matrix", "7-Scenes, ScanNet")
_KEY = re.compile(r"(\s*)(?:- )?([A-Za-z_][\w ]*):\s*(.*)")
_NO_POSE = "no_position_or_not_tracking"
_LARGEST = 1 << 28  # bytes of a JSON document
_END = 3 * "-"  # line after a message in YAML


def rewritten(path: Path, head: Sequence[str]) -> Records | None:
    """Return the rows of a file that is no table of poses, and their layout if it is known.

    Lines of records begin with a header. None if the file is a table.
    """
    if path.is_dir():
        return _folder(path)
    text = "\n".join(head)
    if "VERTEX" in text and (match := _TAG.search(text)):
        tag = match[1]
        return Records(lambda advance: _vertices(path, advance, tag), _GRAPHS[tag])
    rows = [line.split() for line in head[:120] if line.strip() and line.lstrip()[0] not in "#%"]
    if _COLMAP in text or (rows and _is_image(rows[0])):
        return Records(lambda advance: _images(path, advance), _IMAGES)
    if (
        len(rows) >= 4
        and _is_block(rows[:4])
        and all(_is_block(rows[at : at + 4]) for at in range(0, min(len(rows) - 3, 40), 4))
    ):
        return Records(lambda advance: _blocks(path, advance, 4), _STACKED)
    if len(rows) >= 5 and len(rows[0]) == 3 and _is_block(rows[1:5]):
        return Records(lambda advance: _blocks(path, advance, 5), _LOGGED)
    beginning = text.lstrip()[:2000]
    if beginning[:1] in "{[" and re.match(r"\{|\[\s*\{", beginning):
        left_out: dict[str, int] = {}
        return Records(lambda _: _table_of(path, _json(path, left_out)), None, left_out)
    if re.match(
        r"(?:---\s+)?(?:header|position|pose|transform|seq|latitude)\b:?", beginning
    ) and re.search(r"(?m)^\s*\w+:\s", beginning):
        return Records(lambda advance: _table_of(path, _messages(path, advance)))
    return None


def _is_block(rows: list[list[str]]) -> bool:
    """Return whether four lines are a 4 x 4 matrix."""
    numbers = [[number(word) for word in row] for row in rows]
    return all(len(row) == 4 and None not in row for row in numbers) and numbers[3] == [0, 0, 0, 1]


def _is_image(row: list[str]) -> bool:
    """Return whether a line is an image of COLMAP: an id, a pose, a camera, and a name."""
    if len(row) < 10 or not (row[0] + row[8]).isdigit() or not re.search(_PICTURE, row[-1]):
        return False
    numbers = [number(word) or 0.0 for word in row[1:5]]
    return abs(sum(value * value for value in numbers) - 1.0) < 1e-2


def _vertices(path: Path, advance: Advance | None, tag: str) -> Iterator[str]:
    """Yield the poses of a graph, which have one tag."""
    with open_lines(path, advance) as lines:
        for at, line in enumerate(lines, 1):
            word = line.split(maxsplit=1)[0] if line.startswith("VERTEX") else ""
            if word != tag and word in _GRAPHS:
                raise InputError(
                    f"{path}, line {at}: {word} after {tag}; keep the poses of one type: "
                    f"grep -v '^{tag} ' {path.name} > one.g2o"
                )
            yield line[len(tag) :] if word == tag else "\n"


def _images(path: Path, advance: Advance | None) -> Iterator[str]:
    """Yield the poses of images; a line with the points of an image follows its pose."""
    is_pose = True
    with open_lines(path, advance) as lines:
        for line in lines:
            words = [] if line.startswith("#") else line.split(maxsplit=9)
            if is_pose and words:
                digits = re.findall(r"\d+", words[9]) if len(words) == 10 else []
                yield " ".join([digits[-1] if digits else words[0], *words[1:8]]) + "\n"
            else:
                yield "\n"
            if not line.startswith("#") and (words or not is_pose):
                is_pose = not is_pose


def _blocks(path: Path, advance: Advance | None, size: int) -> Iterator[str]:
    """Yield every `size` lines with numbers as one, of an index and a matrix or of a matrix."""
    part: list[str] = []
    at = 0
    with open_lines(path, advance) as lines:
        for at, line in enumerate(lines, 1):  # noqa: B007 - used below
            words = line.split("#")[0].strip()
            if words:
                part.append(words)
            if len(part) == size:
                yield " ".join(part) + "\n"
                part = []
            else:
                yield "\n"
    if part:
        raise InputError(f"{path}, line {at}: {len(part)} of {size} lines of a pose; complete it")


def _folder(path: Path) -> Records | None:
    """Return the poses of a folder with one matrix per file, by the numbers in their names."""
    files = {
        int(digits[-1]): file
        for file in sorted(path.iterdir())
        if file.suffix == ".txt"
        and (digits := re.findall(r"\d+", file.name.split(".")[0]))
        and file.stat().st_size < 4096
    }

    def matrix_in(file: Path) -> list[str]:
        words = file.read_text("latin-1").split()
        if len(words) not in (12, 16):
            raise InputError(
                f"{file} is not a 4 x 4 matrix: 12 or 16 numbers expected, found {len(words)}"
            )
        return words[:12]

    def lines(_: object) -> Iterator[str]:
        for frame, file in sorted(files.items()):
            yield f"{frame} {' '.join(matrix_in(file))} 0 0 0 1\n"

    with contextlib.suppress(InputError):
        for file in files.values():
            matrix_in(file)
            return Records(lines, _FOLDER)
    return None


def _table_of(path: Path, records: Iterable[Mapping[str, str]]) -> Iterator[str]:
    """Yield a header and the rows of records with the same keys, between tabs."""
    names: list[str] = []
    for record in records:
        if not names:
            names = list(record)
            yield "\t".join(names) + "\n"
        yield "\t".join(record.get(name, "") for name in names) + "\n"
    if not names:
        raise InputError(f"{path} has no record with a position")


def _has_position(record: Mapping[str, str]) -> bool:
    last = {key.rpartition(".")[2].lower() for key in record}
    return {"x", "y", "z"} <= last or "m11" in last or "latitude" in last


def _messages(path: Path, advance: Advance | None) -> Iterator[dict[str, str]]:
    """Yield the numbers of messages as rostopic and ros2 topic echo print them."""
    record: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    with open_lines(path, advance) as lines:
        for line in itertools.chain(map(str.rstrip, lines), [_END]):
            if line == _END:
                if _has_position(record):
                    yield record
                record, above = {}, []
            match = _KEY.match(line)
            if match is None:
                continue
            indent, name, value = match.groups()
            above = [parent for parent in above if parent[0] < len(indent)]
            key = ".".join([*(parent for _, parent in above), name])
            if not value:
                above.append((len(indent), name))
            elif value.startswith("["):
                words = value[1:].split(",")
                record |= {f"{key}{at}": word.strip(" ]") for at, word in enumerate(words)}
            else:
                record[key] = value.strip("'\"").replace("\t", " ")


def _json(path: Path, left_out: dict[str, int]) -> Iterator[dict[str, str]]:
    """Yield the numbers of every record; those without a position are left out and counted."""
    left_out.clear()
    for record in _objects(path):
        fields = record if isinstance(record, dict) else {}
        states = [fields.get(key) for key in ("status", "trackingStatus")]
        words = [state for state in states if isinstance(state, str) and not state.isdigit()]
        values = dict(_flat(record, "wxyz" if "token" in fields else ""))
        if _has_position(values) and all(word.upper() == "TRACKING" for word in words):
            yield values
        else:
            left_out[_NO_POSE] = left_out.get(_NO_POSE, 0) + 1


def _objects(path: Path) -> Iterator[Any]:
    """Yield the objects of JSON lines, or of the first list in a document."""
    with open_lines(path) as lines:
        first = lines.readline()
        numbered = enumerate(lines, 2)
        # A document can be one line.
        second = next((item for item in numbered if item[1].strip()), None)
        if second and first.strip().endswith("}") and isinstance(_parsed(first), dict):
            for at, line in itertools.chain([(1, first), second], numbered):
                value = _parsed(line) if line.strip() else {}
                if isinstance(value, Exception):
                    raise InputError(f"{path}, line {at}: no JSON object; write one per line")
                if value:
                    yield value
            return
    if path.stat().st_size > _LARGEST:
        raise InputError(f"{path} is a JSON document of more than 256 MiB; write JSON lines")
    document = _parsed(path.read_text("utf-8-sig", "replace"))
    if isinstance(document, Exception):
        is_deep = isinstance(document, RecursionError)
        why = "its objects are nested too deeply" if is_deep else document
        raise InputError(f"{path} is not valid JSON: {why}")
    if isinstance(document, dict):
        lists = (
            value
            for value in document.values()
            if isinstance(value, list) and isinstance(next(iter(value), None), dict)
        )
        document = next(lists, [document])
    yield from document


def _parsed(text: str) -> Any:
    """Return the value of JSON, with numbers as text, or the exception that it raises."""
    try:
        return json.loads(text, parse_float=str, parse_int=str, parse_constant=str)
    except (ValueError, RecursionError) as error:
        return error


def _flat(
    record: object, order: str, before: str = "", depth: int = 0
) -> Iterator[tuple[str, str]]:
    """Yield the numbers and texts of an object, with keys joined by dots.

    `order`: of a list of four numbers, "" if it is unknown.
    """
    parts: Iterable[tuple[object, Any]] = ()
    if isinstance(record, Mapping):
        parts = record.items()
    elif isinstance(record, list):
        names = {3: "xyz", 4: order}.get(len(record)) or range(min(len(record), 99))
        parts = zip(names, record, strict=False)
        if len(record) in (3, 4) and all(
            isinstance(row, list) and len(row) == 4 for row in record
        ):  # a matrix
            entries = itertools.product(range(1, 4), range(1, 5))
            parts = [(f"m{row}{at}", str(record[row - 1][at - 1])) for row, at in entries]
    elif isinstance(record, str):
        yield before, record.replace("\t", " ").replace("\n", " ").strip()[:60]
    for name, value in parts if depth < 20 else ():
        yield from _flat(value, order, f"{before}.{name}" if before else str(name), depth + 1)
