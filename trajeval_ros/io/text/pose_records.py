"""Files whose poses are not one per line, rewritten as lines of a table.

Graphs of g2o, stacked 4 x 4 matrices, folders of poses, COLMAP, YAML of rostopic and JSON become a
table, so that one reader checks and converts all. Blank lines keep the numbers of lines right.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.text.layouts import _CAMERA, _known
from trajeval_ros.io.text.lines import Advance, open_lines
from trajeval_ros.io.text.names import GROUPS
from trajeval_ros.io.text.table import Records, number

_MATRIX = f"{' '.join(GROUPS['matrix'])} _ _ _ _"
_TAG = re.compile(r"(?m)^(VERTEX_SE3:QUAT|VERTEX_SE2)\s")
_GRAPHS = {
    "VERTEX_SE3:QUAT": _known("g2o", "frame x y z qx qy qz qw", "unit", "g2o wiki: file format"),
    "VERTEX_SE2": _known("g2o", "frame x y yaw", "", "g2o wiki: file format"),
}
_COLMAP = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
_IMAGES = _known(
    "COLMAP", "frame qw qx qy qz x y z", "unit", "colmap.github.io: output format",
    inverse=True, up=_CAMERA, note="frame numbers from the names of the images",
)  # fmt: skip
_STACKED = _known("stacked 4 x 4 matrices", _MATRIX, "matrix bottom", "NICE-SLAM, 7-Scenes")
_LOGGED = _known("Open3D log", f"frame _ _ {_MATRIX}", "matrix", "open3d.org: camera trajectory")
_FOLDER = _known("folder of 4 x 4 matrices", f"frame {_MATRIX}", "matrix", "7-Scenes, ScanNet")
_KEY = re.compile(r"(\s*)(?:- )?([A-Za-z_][\w ]*):\s*(.*)")
_TF_ECHO = (
    r"At time (\S+)\s*\n- Translation: \[(.*)\]\s*\n- Rotation: in Quaternion \S*\s*\[(.*)\]"
)
_OTHER_VERTEX, _NO_POSE = "other_vertex_type", "no_position_or_not_tracking"
_LARGEST = 1 << 28  # bytes of a JSON document
_END = 3 * "-"  # line after a message in YAML
_STATUS = ("status", "trackingStatus")


def rewritten(path: Path, head: Sequence[str]) -> Records | None:
    """Return the rows of a file that is no table of poses, and their layout if it is known.

    Lines of records begin with a header. None if the file is a table.
    """
    if path.is_dir():
        return _folder(path)
    text = "\n".join(head)
    if found := _TAG.search(text):
        tag = found[1]
        left_out: dict[str, int] = {}
        return Records(
            lambda advance: _tagged(open_lines(path, advance), tag, left_out),
            _GRAPHS[tag],
            left_out,
        )
    if _COLMAP in text:
        return Records(lambda advance: _images(path, advance), _IMAGES)
    rows = [line.split() for line in head[:120] if line.strip() and line.lstrip()[0] not in "#%"]
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
        left_out = {}
        return Records(lambda _: _table_of(path, _json(path, left_out)), None, left_out)
    if re.match(
        r"(?:---\s+)?(?:header|position|pose|transform|seq|At time \S+|latitude)\b:?", beginning
    ) and _is_yaml(beginning):
        return Records(lambda advance: _table_of(path, _messages(path, advance)))
    return None


def _is_yaml(text: str) -> bool:
    return ":" in text and ("- Translation" in text or bool(re.search(r"(?m)^\s*\w+:\s", text)))


def _is_block(rows: list[list[str]]) -> bool:
    """Return whether four lines are a 4 x 4 matrix."""
    numbers = [[number(each) for each in row] for row in rows]
    return all(len(row) == 4 and None not in row for row in numbers) and numbers[3] == [0, 0, 0, 1]


def _tagged(lines: TextIO, tag: str, left_out: dict[str, int]) -> Iterator[str]:
    """Yield the vertices of a graph with one tag; those with another tag are counted."""
    left_out.clear()
    with lines:
        for line in lines:
            if line.startswith((f"{tag} ", f"{tag}\t")):
                yield line[len(tag) :]
            else:
                if line.startswith("VERTEX_SE"):
                    left_out[_OTHER_VERTEX] = left_out.get(_OTHER_VERTEX, 0) + 1
                yield "\n"


def _images(path: Path, advance: Advance | None) -> Iterator[str]:
    with open_lines(path, advance) as lines:
        yield from _image_rows(lines)


def _image_rows(lines: Iterable[str]) -> Iterator[str]:
    is_pose = True
    for line in lines:
        if line.startswith("#"):
            yield "\n"
            continue
        if is_pose and line.strip():
            words = line.split(maxsplit=9)
            digits = re.findall(r"\d+", words[-1])
            yield (
                " ".join([digits[-1] if len(words) == 10 and digits else words[0], *words[1:8]])
                + "\n"
            )
        else:
            yield "\n"
        is_pose = not is_pose if line.strip() or not is_pose else is_pose


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
    files = {}
    for each in sorted(path.iterdir()):
        digits = re.findall(r"\d+", each.name.split(".")[0])
        if each.suffix == ".txt" and digits and each.stat().st_size < 4096:
            files[int(digits[-1])] = each
    if not files:
        return None
    if len(next(iter(files.values())).read_text("latin-1").split()) not in (12, 16):
        return None

    def lines(_: object) -> Iterator[str]:
        for frame, file in sorted(files.items()):
            words = file.read_text("latin-1").split()
            if len(words) not in (12, 16):
                raise InputError(
                    f"{file} is not a 4 x 4 matrix: 12 or 16 numbers expected, found {len(words)}"
                )
            yield f"{frame} {' '.join(words[:12])} 0 0 0 1\n"

    return Records(lines, _FOLDER)


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
    with open_lines(path, advance) as lines:
        yield from _yaml(lines)


def _yaml(lines: Iterable[str]) -> Iterator[dict[str, str]]:
    """Yield the numbers of messages as rostopic and ros2 topic echo print them."""
    record: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    for line in lines:
        line = line.rstrip()
        if line == _END or line.startswith("At time"):
            if _has_position(record):
                yield record
            record, above = {}, []
        if line.startswith("At time"):
            record["time"] = line.split()[-1]
            continue
        found = re.search(r"(Translation|Quaternion)[^\[]*\[(.*)\]", line)
        if found:
            record |= {
                f"{found[1]}.{axis}": each.strip()
                for axis, each in zip("xyzw", found[2].split(","), strict=False)
            }
            continue
        match = _KEY.match(line)
        if match is None:
            continue
        depth = len(match[1])
        above = [each for each in above if each[0] < depth]
        key = ".".join([name for _, name in above] + [match[2]])
        if not match[3]:
            above.append((depth, match[2]))
        elif match[3].startswith("["):
            record |= {
                f"{key}{at}": each.strip(" ]") for at, each in enumerate(match[3][1:].split(","))
            }
        else:
            record[key] = match[3].strip("'\"").replace("\t", " ")
    if _has_position(record):
        yield record


def _json(path: Path, left_out: dict[str, int]) -> Iterator[dict[str, str]]:
    """Yield the numbers of every record; those without a position are left out and counted."""
    left_out.clear()
    with open_lines(path) as file:
        first = file.readline()
        try:
            json.loads(first)
            lines: Iterable[Any] = (first, *file) if first.strip()[-1:] == "}" else ()
        except (ValueError, RecursionError):
            lines = ()
    if lines:
        records = _parsed(path, lines)
    else:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path} is a JSON document of more than 256 MiB; write JSON lines")
        try:
            document = json.loads(
                path.read_text("utf-8-sig", "replace"),
                parse_float=str,
                parse_int=str,
                parse_constant=str,
            )
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path} is not valid JSON: {error}") from None
        if isinstance(document, dict):
            document = next(
                (each for each in document.values() if isinstance(each, list)), [document]
            )
        records = iter(document)
    for record in records:
        status = [record.get(each) for each in _STATUS] if isinstance(record, dict) else []
        if all(
            each.upper() == "TRACKING"
            for each in status
            if isinstance(each, str) and not each.isdigit()
        ):
            values = dict(
                _flat(record, "wxyz" if isinstance(record, dict) and "token" in record else "")
            )
            if _has_position(values):
                yield values
                continue
        left_out[_NO_POSE] = left_out.get(_NO_POSE, 0) + 1


def _parsed(path: Path, lines: Iterable[str]) -> Iterator[Any]:
    for at, line in enumerate(lines, 1):
        if line.strip():
            try:
                yield json.loads(line, parse_float=str, parse_int=str, parse_constant=str)
            except (ValueError, RecursionError):
                raise InputError(
                    f"{path}, line {at}: no JSON object; write one per line"
                ) from None


def _flat(
    record: object, order: str, before: str = "", depth: int = 0
) -> Iterator[tuple[str, str]]:
    """Yield the numbers and texts of an object, with keys joined by dots.

    `order`: of a list of four numbers, "" if it is unknown.
    """
    if isinstance(record, Mapping) and depth < 20:
        for key, value in record.items():
            yield from _flat(value, order, f"{before}.{key}" if before else str(key), depth + 1)
    elif (
        isinstance(record, list)
        and len(record) in (3, 4)
        and all(isinstance(each, list) and len(each) == 4 for each in record)
    ):
        for row, part in enumerate(record[:3], 1):
            yield from ((f"{before}.m{row}{at}", str(each)) for at, each in enumerate(part, 1))
    elif isinstance(record, list) and depth < 20:
        names = {3: "xyz", 4: order}.get(len(record)) or [
            str(at) for at in range(min(len(record), 99))
        ]
        for name, value in zip(names, record, strict=False):
            yield from _flat(value, order, f"{before}.{name}", depth + 1)
    elif isinstance(record, str):
        yield before, record.replace("\t", " ").replace("\n", " ").strip()[:60]
