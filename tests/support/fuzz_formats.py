"""Inputs of every format, changed as their structure allows: what `make fuzz` reads.

A changed input knows how many poses a careful reader finds in it. Where nothing in a format can
tell that poses are gone, as in a text that ends a line early, those are not counted.
"""

from __future__ import annotations

import atexit
import functools
import io
import itertools
import json
import shutil
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from damaged_bags import definition, payloads
from fuzz_changes import (
    ODD,
    Changed,
    Make,
    Random,
    pick,
    with_other_bytes,
    with_other_values,
    yaml_of,
)
from fuzz_hostile import make_hostile
from fuzz_more_formats import MORE_FORMATS
from fuzz_text import TEXT_FORMATS
from gate_tables import made_table
from mcap.records import Channel, Schema
from mcap_layouts import Layout, Part, record
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from state_file_contents import DESCRIPTION, STATE, columns, write_groundtruth
from state_rows import trajectory

from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.gate import GateValues
from trajeval_ros.batch.records import (
    HEAD_BYTES,
    OWN,
    Record,
    RecordStore,
    decode,
    encode,
    entry_head,
)
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.covariance_file import read_joint_covariance
from trajeval_ros.io.hand_eye_file import read_hand_eye
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.state_file import FORMAT, StateWriter
from trajeval_ros.io.requests.request_from import read_protocol
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import read_trajectory

COUNT = 60
SECOND = 10**9
STORE, ROS1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
_YAMLS = {
    "hand_eye.yaml": """
header: {frame_id: base_link}
child_frame_id: marker
transform:
  translation: {x: 0.1, y: -0.05, z: 0.2}
  rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}
""",
    "protocol.yaml": """
base: uzh-fpv
gauge: yaw
align_states: all
association: nearest
max_time_difference: 0.02
max_gap: 0.5
time_offset: 0.0
lengths: [40, 60, 80]
sub_trajectory_rule: nearest
sub_trajectory_step: 1
lever_arm: [0.059, -0.00855, 0.1964]
score: {bounds_m: [0.01, 0.1], points: [10, 1], best: 100}
""",
    "compare.yaml": """
title: all
groundtruth: "{sequence}/truth.txt"
runs: {vio: "{sequence}/vio_{trial}.txt", slam: "{sequence}/slam_{trial}.txt"}
sequences: [a, b]
trials: ["0"]
lengths: [8, 16]
gauge: yaw
common_time_span: true
""",
}


def make_mcap(random: Random, folder: Path) -> Changed:
    """Lay a file out at random, and lie in it, or change its bytes."""
    cuts = sorted({0, COUNT, *random.integers(0, COUNT, 4).tolist()})
    rows = [
        (item, time * SECOND, payload if item == 1 else b"other")
        for time, payload in enumerate(payloads(COUNT))
        for item in (1, 2)
    ]
    parts = [
        Part(
            rows[2 * begin : 2 * end],
            is_chunk=bool(random.random() < 0.8),
            compression=str(random.choice(["", "zstd", "lz4"])),
            unindexed=frozenset(np.flatnonzero(random.random(3) < 0.1).tolist()),
            is_listed=bool(random.random() < 0.9),
            behind=record(int(random.integers(8, 256)), b"more") if random.random() < 0.2 else b"",
            size=pick(random, [0, 1, 2**31, 2**62, 2**64 - 1]) if random.random() < 0.1 else None,
        )
        for begin, end in itertools.pairwise(cuts)
    ]
    layout = Layout(
        [Schema(1, definition(POSE_STAMPED), "ros2msg", POSE_STAMPED)],
        [Channel(1, "/pose", "cdr", {}, 1), Channel(2, "/other", "x", {}, 0)],
        parts,
        has_summary=bool(random.random() < 0.7),
        repeats=bool(random.random() < 0.8),
        has_statistics=bool(random.random() < 0.8),
        counts={1: pick(random, [0, 7, COUNT, 10**6])} if random.random() < 0.1 else {},
    )
    content = bytes(layout)
    is_counted = layout.has_summary and layout.has_statistics and not layout.counts
    poses, what = COUNT, "layout"
    if random.random() < 0.6:
        content, what = with_other_bytes(random, content)
        # Without statistics, a record that became one of a private kind hides what it held.
        poses = COUNT if is_counted and layout.repeats else 0
    path = folder / "x.mcap"
    path.write_bytes(content)
    return Changed(what, reading(path), poses)


def make_sqlite(random: Random, folder: Path) -> Changed:
    """Change cells, rows and columns by statements, or pages by bytes."""
    bag = copied(intact() / "bag", folder / "bag")
    path = bag / "bag.db3"
    if random.random() < 0.5:
        content, what = with_other_bytes(random, path.read_bytes())
        path.write_bytes(content)
        return Changed(what, reading(bag), COUNT)
    table = pick(random, ["topics", "messages", "messages", "message_definitions", "schema"])
    database = sqlite3.connect(path)
    columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    column, value = pick(random, columns), pick(random, ODD)
    value = value if isinstance(value, (str, bytes, float)) else str(value)[:30]
    statement, values = pick(
        random,
        [
            (f"UPDATE {table} SET {column} = ? WHERE rowid % 3 = 0", [value]),
            (f"UPDATE {table} SET {column} = ? WHERE rowid = 1", [value]),
            (f"UPDATE {table} SET {column} = CAST({column} AS BLOB)", []),
            (f"DELETE FROM {table} WHERE rowid % 7 = 0", []),
            (f"ALTER TABLE {table} RENAME COLUMN {column} TO other", []),
            (f"DROP TABLE {table}", []),
            (f"CREATE VIEW v AS SELECT * FROM {table}", []),
        ],
    )
    try:
        with database:
            database.execute(statement, values)
    except sqlite3.Error:  # what sqlite itself refuses
        pass
    database.close()
    return Changed(f"{statement} {value!r}", reading(bag), COUNT)


def make_ros1(random: Random, folder: Path) -> Changed:
    path = folder / "x.bag"
    content = (intact() / "x.bag").read_bytes()
    changed, what = with_other_bytes(random, content)
    path.write_bytes(changed)
    return Changed(what, reading(path), COUNT)


def make_text(random: Random, folder: Path) -> Changed:
    """Change cells and lines of a table in text."""
    is_csv = random.random() < 0.4
    comma = "," if is_csv else " "
    stamps = [f"{row}500000000" if is_csv else f"{row}.5" for row in range(1, COUNT + 1)]
    lines = [comma.join([stamp, f"{0.1 * row:.3f}", "0", "0", "0", "0", "0", "1"])
             for row, stamp in enumerate(stamps)]  # fmt: skip
    poses, what = COUNT, []
    for _ in range(int(random.integers(1, 3))):
        place = int(random.integers(len(lines)))
        cells = lines[place].split(comma)
        kind = pick(random, ["cell", "nan", "number", "missing", "comment", "twice", "noise"])
        what.append(f"{kind} in line {place + 1}")
        if kind == "cell":
            cells[int(random.integers(len(cells)))] = str(pick(random, ODD))
        elif kind == "missing":
            cells.pop()
        elif kind == "nan":
            cells[int(random.integers(len(cells)))] = pick(random, ["nan", "inf", "-nan"])
        elif kind == "number":
            cells[int(random.integers(len(cells)))] = (
                f"{random.normal() * 10.0 ** random.integers(99)}"
            )
        elif kind == "noise":
            cells = [random.bytes(20).decode("latin-1")]
        lines[place] = comma.join(cells)
        if kind == "comment" and not lines[place].startswith("#"):
            lines[place], poses = f"#{lines[place]}", poses - 1
        elif kind == "twice":
            lines.insert(place, lines[place])
    text = pick(random, [*["\n"] * 6, "\r\n", "\r"]).join(lines)
    encoding = pick(random, [*["utf-8"] * 8, "utf-8-sig", "utf-16", "latin-1"])
    path = folder / "x.txt"
    path.write_bytes(text.encode(encoding, errors="replace"))
    # Noise may be a comment, or break a line in two.
    return Changed(
        ", ".join(what), reading(path), 0 if "noise" in str(what) else poses - len(what)
    )


def make_yaml(random: Random, folder: Path) -> Changed:
    """Change values of a tree, or its text."""
    name = pick(random, ["hand_eye.yaml", "protocol.yaml", "compare.yaml", "metadata.yaml"])
    bag = copied(intact() / "bag", folder / "bag")
    tree = YAML(typ="safe").load(_YAMLS[name]) if name in _YAMLS else None
    path = folder / name
    if tree is None:
        path = bag / name
        tree = YAML(typ="safe").load(path)
    text = yaml_of(with_other_values(random, tree))
    if random.random() < 0.3:
        text = with_other_bytes(random, text)[0]
    path.write_bytes(text)
    if name == "metadata.yaml":
        return Changed(name, reading(bag))
    read: Any = {
        "hand_eye.yaml": read_hand_eye,
        "protocol.yaml": read_protocol,
        "compare.yaml": lambda item: plan_of(item, {}),
    }[name]
    return Changed(name, lambda strict: read(path) and None)


def make_npz(random: Random, folder: Path) -> Changed:
    """Change arrays of an archive, or its bytes."""
    arrays: dict[str, Any] = {
        "stamps_ns": np.arange(5),
        "positions": random.normal(size=(5, 3)),
        "quaternions": np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)),
        "block": np.array("p,phi"),
        "gauge": np.array("prior"),
        "cov": np.eye(30),
    }
    what = "bytes"
    if random.random() < 0.6:
        name = pick(random, [*arrays, "perturbation", "info", "info_data", "info_indptr", "more"])
        arrays[name] = pick(
            random,
            [
                np.zeros(0), np.zeros((5, 3)), np.zeros((2, 2, 2)), np.array("x"), np.eye(30) * 1j,
                np.full((30, 30), np.nan), np.array([{}]), np.array(["\0"]), np.array(2**63, "u8"),
                np.zeros(3000000), np.array(5), np.eye(30, dtype=bool), np.zeros(5, "M8[ns]"),
                np.zeros(5, [("a", "f8")]), np.array(b"\xff"), np.array([2**70]),
            ],
        )  # fmt: skip
        what = f"{name} is {arrays[name].dtype} {arrays[name].shape}"
        if random.random() < 0.2:
            arrays.pop(pick(random, list(arrays)))
    output = io.BytesIO()
    write = pick(random, [np.savez, np.savez_compressed])
    write(output, **arrays, allow_pickle=True)
    content = output.getvalue()
    if what == "bytes" or random.random() < 0.1:
        content, changed = with_other_bytes(random, content)
        what = f"{what}, {changed}"
    path = folder / "x.npz"
    path.write_bytes(content)

    def read(strict: bool) -> None:  # noqa: ARG001
        read_joint_covariance(path)

    return Changed(what, read)


def make_states(random: Random, folder: Path) -> Changed:
    """Change texts and rows under valid checksums, or bytes; or the revision beside them."""
    texts: list[Any] = [{**DESCRIPTION, "format": FORMAT}, STATE]
    number = int(random.integers(2))
    if random.random() < 0.5:
        texts[number] = with_other_values(random, texts[number])
    stamps, _, estimate = (column.copy() for column in columns())
    if random.random() < 0.3:
        place = tuple(random.integers(0, (len(stamps), 10)))
        estimate[place] = pick(random, [np.nan, np.inf, 1e308, 0.0])
        stamps[int(random.integers(len(stamps)))] = pick(random, [0, -1, 2**63 - 1, stamps[0]])
    rows = np.empty(len(stamps), dtype=[("s", "<i8"), ("a", "<i8"), ("e", "<f8", 10)])
    rows["s"], rows["a"], rows["e"] = stamps, stamps, estimate
    content = b""
    for text, own in ((texts[0], rows[:0]), ("", rows), (texts[1], rows[:0])):
        body = (json.dumps(text).encode() if text else b"") + own.tobytes()
        length = len(body) - own.nbytes
        content += struct.pack("<4sIII", b"TESN", len(own), length, zlib.crc32(body)) + body
    if random.random() < 0.2:
        content, _ = with_other_bytes(random, content)
    write_groundtruth(folder)
    (folder / "vio.states").write_bytes(content)
    if random.random() < 0.2:
        path = folder / "vio.revised"
        writer = StateWriter(path, DESCRIPTION)
        writer.append(trajectory(stamps, estimate))
        writer.close()
        path.write_bytes(with_other_bytes(random, path.read_bytes())[0])

    def read(strict: bool) -> None:  # noqa: ARG001
        json_text(result_of(evaluate_folder(folder)))

    return Changed("texts", read)


def make_records(random: Random, folder: Path) -> Changed:
    """Change a record of a comparison, or the columns of its table in Parquet."""
    if random.random() < 0.4:
        columns = {"path": np.zeros((4, 3)), "8m.position_m": np.zeros(5)}
        entry = encode(Record("0" * 32, {"runs": [{}]}, ("8m",), (0, 1), columns))
        if random.random() < 0.5:
            head = entry_head(entry)
            assert head is not None
            line, _, values = entry[HEAD_BYTES:].partition(b"\n")
            changed = json.dumps(with_other_values(random, json.loads(line))).encode()
            drawn = changed + b"\n" + values[:-40]
            head = head._replace(drawn_bytes=len(drawn), drawn_sum=zlib.crc32(drawn))
            return Changed("record", lambda strict: decode(head, drawn, values[-40:]) and None)
        entry, _ = with_other_bytes(random, entry)
        (folder / OWN).write_bytes(entry)
        return Changed("record", lambda strict: RecordStore(folder).read("0" * 32) and None)
    import pyarrow
    from pyarrow import parquet

    path = folder / "runs.parquet"
    table = parquet.read_table(intact() / "runs.parquet")
    what = "bytes"
    if random.random() < 0.7:
        name = pick(random, table.column_names)
        values = pick(random, [[None], [1], ["x"], [b"\xff"], [0.5], [[1]], [{"a": 1}], [True]])
        column = pyarrow.array(values * table.num_rows)
        place = table.column_names.index(name)
        table = pick(
            random, [table.drop([name]), table.set_column(place, name, column), table.slice(0, 0)]
        )
        what = f"{name} is {values}"
    if random.random() < 0.3:
        metadata = dict(table.schema.metadata)
        metadata[pick(random, list(metadata))] = json.dumps(str(pick(random, ODD))).encode()
        table = table.replace_schema_metadata(metadata)
    parquet.write_table(table, path)
    if what == "bytes":
        path.write_bytes(with_other_bytes(random, path.read_bytes())[0])

    def read(strict: bool) -> None:  # noqa: ARG001
        values = GateValues(ResultsTable(path))
        values.trials("ate.position_m.rmse", values)

    return Changed(what, read)


def reading(path: Path) -> Callable[[bool], Trajectory]:
    """Return what reads the one topic of poses, or the text."""
    return lambda strict: read_trajectory(path, strict=strict)


def copied(bag: Path, to: Path) -> Path:
    shutil.copytree(bag, to)
    return to


@functools.cache
def intact() -> Path:
    """Return a folder with an intact input of each kind that takes long to write."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    atexit.register(shutil.rmtree, folder)
    writer = Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connection = writer.add_connection("/pose", POSE_STAMPED, typestore=STORE)
        for row, payload in enumerate(payloads(COUNT)):
            writer.write(connection, row * SECOND, payload)
    with Ros1Writer(folder / "x.bag") as old:
        topic = old.add_connection("/pose", POSE_STAMPED, typestore=ROS1)
        for row in range(COUNT):
            pose = struct.pack("<4I3s7d", row, row + 1, 0, 3, b"map", row, 0, 0, 0, 0, 0.6, 0.8)
            old.write(topic, row * SECOND, pose)
    made_table(folder / "runs.parquet", {"a": [0.1, 0.2], "b": [0.3, None]})
    return folder


FORMATS: dict[str, Make] = {
    "mcap": make_mcap,
    "sqlite3": make_sqlite,
    "ros1": make_ros1,
    "text": make_text,
    "yaml": make_yaml,
    "npz": make_npz,
    "states": make_states,
    "records": make_records,
    "hostile": make_hostile,
    **MORE_FORMATS,
    **TEXT_FORMATS,
}
