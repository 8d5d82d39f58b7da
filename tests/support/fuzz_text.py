"""Changed inputs of the reader of text: all layouts, records, compression, arrays and JSON."""

from __future__ import annotations

import bz2
import functools
import gzip
import io
import json
import lzma
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_changes import Changed, Make, Random, pick, with_other_bytes, with_other_values
from nmea import PLACES, gga

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import SideHints
from trajeval_ros.io.text.layouts import KNOWN

COUNT = 12
TOKENS = (
    "nan", "-nan(ind)", "inf", "1e400", "-1e-400", "9e18", "-9223372036854775808", "1.7e+18",
    "1_000", "0x10", "", '"', "'", ",", ";", "\t", "\r", "\n", "\r\n", "#", "%", "\0", "\xff", "{",
    "[", "]", "}", "---\n", ":", "header:\n", "$GPGGA,1,2", "VERTEX_SE3:QUAT ", "1" * 300,
    "9" * 45, "2024-02-30", "31/12/1999", "25:61:61", "+.5", ".", "e5", "x y z", "time,x,y,z\n",
    "NO_OF_FRAMES\t4\n", " " * 3000, "1 " * 5000, "\x1f", "\x0b", "\x85", "\xa0", "0 0 0 1\n",
    "# q p v bg ba\n",
)  # fmt: skip
COLUMNS = (
    "t x y z qx qy qz qw", "_ t _ x y", "x y z", "frame x y z qx qy qz qw",
    "t_ns _ x y z qw qx qy qz",
    "t latitude longitude height", "t_s nanosec x y z", "date clock x y z", "frame1 x y z",
    "t_unpadded x y z qx qy qz qw", "t x_mm y_mm z_mm", "t received x y z",
)  # fmt: skip
TIMES = ("0\n1\n2\n", "1.5\n2.5\n" * 30, "x\n", "", "nan\n1\n", "1 2\n", "1e300\n2\n")
HEADERS = (
    "t,x,y,z,qx,qy,qz,qw", "Time (ms), X [mm], Y [mm], Z [mm]", "date,x,y,z,roll,pitch,yaw",
    "%time,field.header.seq,field.header.stamp,field.latitude,field.longitude,field.altitude",
    "time;nsec;pose_x;pose_y;pose_z;q_w;q_x;q_y;q_z", "index,stamp,px,py,height,heading",
)  # fmt: skip
WORDS = {
    "t": "17000000{:02d}.25", "t_us": "17000000{:02d}250000", "t_s": "17000000{:02d}",
    "frame": "{}", "text": "map", "_": "{}", "qw": "0.8", "qz": "0.6", "latitude": "47.3{:02d}",
    "longitude": "8.5", "height": "400", "fix_status": "2", "vx": "0.3", "vy": "0.2",
    "bwx": "0.01", "m11": "0.8", "m12": "-0.6", "m21": "0.6", "m22": "0.8", "m33": "1",
}  # fmt: skip


@functools.cache
def seeds() -> tuple[str, ...]:
    """Return an intact text of every layout, of some headers and of records."""
    texts = []
    for layout in KNOWN:
        separator = "," if {"commas", "vins", "ros2"} & set(layout.checks) else " "
        rows = [[WORDS.get(name, f"0.{row}" if name in "xyz" else "0").format(row)
                 for name in layout.columns] for row in range(COUNT)]  # fmt: skip
        if "bottom" in layout.checks:
            rows = [[*row[:-4], "0", "0", "0", "1"] for row in rows]
        if "vins" in layout.checks:
            rows = [[*row[:-1], ""] for row in rows]
        texts.append("".join(separator.join(row) + "\n" for row in rows))
    for header in HEADERS:
        width = len(header.replace(";", ",").split(","))
        mark = ";" if ";" in header else ","
        rows = [[f"17000000{row:02d}", *(f"{at}.{row:02d}" for at in range(1, width))]
                for row in range(COUNT)]  # fmt: skip
        texts.append("\n".join([header, *map(mark.join, rows)]))
    pose = "0.5 1 2 0 0 0 1"
    texts += [
        "".join(f"VERTEX_SE3:QUAT {row} {pose}\n" for row in range(COUNT)),
        "".join(f"VERTEX_SE2 {row} 1 2 0.5\nEDGE_SE2 0 1 1 0 0\n" for row in range(COUNT)),
        "".join(f"{row} 0 1\n1 0 0 {row}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for row in range(COUNT)),
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
        + "".join(f"{row} 1 0 0 0 {row} 0 0 1 a{row}.png\n1 2 -1\n" for row in range(COUNT)),
        "---\n".join(
            f"header: \n  stamp: \n    secs: {row}\n    nsecs: 5\npose: \n  position: \n    x: 1\n"
            "    y: 2\n    z: 3\n  orientation: \n    x: 0\n    y: 0\n    z: 0\n    w: 1\n"
            for row in range(COUNT)
        ),
        "".join(gga(row, place) + "\n" for row, place in enumerate(PLACES)),
    ]
    return tuple(texts)


def make_layouts(random: Random, folder: Path) -> Changed:
    """Change a text of any layout, its encoding, its compression, its columns and its times."""
    text, what = pick(random, seeds()), []
    for _ in range(int(random.integers(1, 4))):
        at = int(random.integers(len(text) + 1))
        kind = pick(random, ["token", "token", "word", "gone", "cut", "all", "lines", "other"])
        what.append(f"{kind} at {at}")
        lines = text.split("\n")
        if kind == "token":
            text = text[:at] + pick(random, TOKENS) + text[at:]
        elif kind == "word":
            words = text.split(" ")
            words[int(random.integers(len(words)))] = pick(random, TOKENS)
            text = " ".join(words)
        elif kind == "gone":
            text = text[:at] + text[at + int(pick(random, [1, 5, 200])) :]
        elif kind == "cut":
            text = text[:at]
        elif kind == "all":
            text = text.replace(
                pick(random, list(" ,.\n01-")), pick(random, list(" ,;\t\r1-") + [""])
            )
        elif kind == "lines":
            random.shuffle(lines)
            text = "\n".join([*lines, *lines[: int(random.integers(3))] * 30])
        else:
            text = text[:at] + pick(random, seeds())[:500] + text[at:]
    content = text[:400_000].encode(pick(random, [*["latin-1"] * 9, "utf-16"]), "replace")
    packed = pick(random, [*[None] * 8, gzip, bz2, lzma])
    if packed is not None:
        content = packed.compress(content)
        if random.random() < 0.4:
            content, more = with_other_bytes(random, content)
            what.append(more)
    (folder / "x.txt").write_bytes(content)
    if random.random() < 0.2:
        (folder / "times.txt").write_text(pick(random, TIMES))
    columns = pick(random, [*[None] * len(COLUMNS) * 3, *COLUMNS])
    return Changed(f"{columns}: {', '.join(what)}", _reading(folder / "x.txt", columns))


def _reading(path: Path, columns: str | None = None) -> Any:
    def read(strict: bool) -> Trajectory:
        hints = SideHints.of(columns, None).estimate
        return read_trajectory(path, strict=strict, hints=hints)

    return read


def make_arrays(random: Random, folder: Path) -> Changed:
    """Change the type, the shape, the header or bytes of .npy and .npz."""
    shape = pick(
        random, [(5, 8), (5, 7), (5, 3), (5, 4, 4), (5, 12), (5,), (0, 8), (5, 9), (1, 8)]
    )
    kind = pick(random, ["f8", "f4", "i8", "u1", "?", "c16", "U3", "M8[ns]", "f2", ">f8"])
    array: Any = np.zeros(shape) if kind == "M8[ns]" else random.normal(size=shape) * 3
    array = array.astype(kind, casting="unsafe")
    if array.ndim == 3 and kind in ("f8", "f4"):
        array = np.tile(np.eye(4), (5, 1, 1)).astype(kind)
    if array.dtype.kind == "f" and array.size and random.random() < 0.3:
        array.flat[int(random.integers(array.size))] = pick(random, [np.nan, np.inf, 6e4, -0.0])
    output, suffix = io.BytesIO(), pick(random, ["npy", "npz"])
    if suffix == "npy":
        np.save(output, array)
    else:
        more = {pick(random, ["t", "times", "x", "poses2"]): random.normal(size=5)}
        pick(random, [np.savez, np.savez_compressed])(output, poses=array, **more)
    content, what = output.getvalue(), f"{suffix} {kind} {shape}"
    change = random.random()
    if change < 0.3 and suffix == "npy":
        old = str(shape).encode()
        new = pick(random, [b"(9" + b"0" * 12 + b", 8)", b"((((", b"(-1, 8)", b"(2**99,)", b"()"])
        content, what = content.replace(old, new.ljust(len(old))), f"{what} to {new!r}"
    elif change < 0.7:
        content, more_changed = with_other_bytes(random, content)
        what = f"{what}, {more_changed}"
    path = folder / f"x.{suffix}"
    path.write_bytes(content)
    return Changed(what, _reading(path, pick(random, [None, None, None, *COLUMNS])))


def make_json(random: Random, folder: Path) -> Changed:
    """Change values of JSON lines or of a document, or their bytes."""
    pose = {
        "position": {"x": 0.5, "y": 1, "z": 2},
        "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
    }
    records: list[Any] = [{"timestamp": 1.7e9 + row, "pose": pose} for row in range(COUNT)]
    records[3] = with_other_values(random, records[3])
    if random.random() < 0.3:
        depth = int(random.integers(1, 3000))
        records[5] = {"timestamp": 5, "deep": "DEEP"}
    text = "\n".join(map(json.dumps, records))
    if random.random() < 0.4:
        text = json.dumps(with_other_values(random, {"frames": records}))
    if "DEEP" in text:
        text = text.replace('"DEEP"', pick(random, ['{"a":', "["]) * depth + "1")
    if random.random() < 0.2:
        text = text.replace("0.5", pick(random, ["9" * 500, "1e999", "-", "NaN", "Infinity"]))
    content, what = text.encode(), "values"
    if random.random() < 0.3:
        content, what = with_other_bytes(random, content)
    path = folder / "x.jsonl"
    path.write_bytes(content)
    return Changed(what, _reading(path))


TEXT_FORMATS: dict[str, Make] = {
    "layouts": make_layouts,
    "arrays": make_arrays,
    "json": make_json,
}
