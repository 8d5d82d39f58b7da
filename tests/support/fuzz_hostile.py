"""Inputs whose structure no recorder writes: SQL, nested types, huge counts, pipes and links."""

from __future__ import annotations

import os
import shutil
import sqlite3
from pathlib import Path

from damaged_bags import definition, mcap_file, payloads
from fuzz_changes import Changed, Random, pick

from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

COUNT = 20
RULE = "\n" + "=" * 80 + "\n"
HUGE = (0, 1, 20, 2**31, 2**32, 2**62, 2**63 - 1, 2**64, 10**30, 16**6000 - 1)
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT {} FROM c"
EXPRESSIONS = (
    "zeroblob(500000000)", "randomblob(100000000)", "hex(zeroblob(200000000))", "x", "1", "NULL",
    "printf('%.*c', 300000000, 'x')", "abs(random())", "load_extension('x')", "'/pose'",
)  # fmt: skip
COLUMNS = {
    "topics": ("id", "name", "type", "serialization_format", "offered_qos_profiles"),
    "messages": ("id", "topic_id", "timestamp", "data"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}
ROWS = {
    "topics": f"1, '/pose', '{POSE_STAMPED}', 'cdr', ''",
    "messages": "1, 1, 1, x'00'",
    "message_definitions": f"'{POSE_STAMPED}', 'ros2msg', 'float64 x'",
}


def make_hostile(random: Random, folder: Path) -> Changed:
    make = pick(random, [make_sql, make_schema, make_types, make_types, make_folder, make_folder])
    changed: Changed = make(random, folder)
    return changed


def make_sql(random: Random, folder: Path) -> Changed:
    """Make views, computed columns and virtual tables with the names of a bag's tables."""
    path = folder / "x.db3"
    what = []
    with sqlite3.connect(path) as database:
        for table, columns in COLUMNS.items():
            name = pick(random, [table, table, table.upper()])
            kind = pick(random, ["plain", "plain", "view", "computed", "index", "trigger"])
            value = pick(random, EXPRESSIONS)
            names = ", ".join(columns)
            if kind == "view":
                some = ", ".join([pick(random, EXPRESSIONS) for _ in columns])
                script = f"CREATE VIEW {name}({names}) AS {ENDLESS.format(some)};"
            else:
                last = columns[-1]
                computed = pick(random, ["VIRTUAL", "STORED", "VIRTUAL"])
                own = f"{last} AS ({value}) {computed}" if kind == "computed" else last
                stored = columns[:-1] if kind == "computed" else columns
                row = ", ".join(ROWS[table].split(", ")[: len(stored)])
                script = (
                    f"CREATE TABLE {name}({', '.join(columns[:-1])}, {own});"
                    f"INSERT INTO {name}({', '.join(stored)}) VALUES({row});"
                )
                if kind == "index":
                    script += (
                        f"CREATE INDEX i_{table} ON {name}(abs({columns[0]}), length({last}));"
                    )
                elif kind == "trigger":
                    script += (
                        f"CREATE TRIGGER t_{table} AFTER UPDATE ON {name} BEGIN "
                        f"SELECT {value}; END;"
                    )
            # Statements that sqlite refuses, or that a computed column makes too large to store.
            try:
                database.executescript(script)
                what.append(script)
            except (sqlite3.Error, MemoryError) as error:
                what.append(f"{script}: {error}")
    database.close()
    return Changed(" ".join(what), lambda strict: read_trajectory(path, strict=strict))


def make_schema(random: Random, folder: Path) -> Changed:
    """Change the schema of a file itself: the statements, kinds and pages of its tables."""
    path = folder / "x.db3"
    with sqlite3.connect(path) as database:
        for table, columns in COLUMNS.items():
            database.execute(f"CREATE TABLE {table}({', '.join(columns)})")
            database.execute(f"INSERT INTO {table} VALUES({ROWS[table]})")
        database.execute("CREATE INDEX timestamp_idx ON messages(timestamp)")
        database.execute("PRAGMA writable_schema = ON")
        table = pick(random, list(COLUMNS))
        view = f"CREATE VIEW {table}({', '.join(COLUMNS[table])}) AS {ENDLESS.format('x')}"
        column, value = pick(
            random,
            [
                ("rootpage", pick(random, [0, 1, 2, 3, 4, 5, 99, -1])),
                ("type", pick(random, ["view", "index", "trigger", "x"])),
                ("name", pick(random, [*COLUMNS, "sqlite_master"])),
                ("sql", view),
                ("sql", f"CREATE TABLE {table}(a DEFAULT (zeroblob(500000000)), b)"),
                ("sql", f"CREATE VIRTUAL TABLE {table} USING fts5(a)"),
                ("sql", f"CREATE TABLE {table} AS {ENDLESS.format('x')}"),
            ],
        )
        database.execute(f"UPDATE sqlite_master SET {column} = ? WHERE name = ?", (value, table))
    database.close()
    what = f"{table}: {column} = {value}"
    return Changed(what, lambda strict: read_trajectory(path, strict=strict))


def make_types(random: Random, folder: Path) -> Changed:
    """Record a definition of nested types, with arrays of any length."""
    levels, fields = int(random.integers(1, 60)), int(random.integers(1, 12))
    kinds = ("float64", "string", "uint8", "a/A0", "wstring", "a/Missing")

    def line(level: int, number: int) -> str:
        kind = f"a/A{level + 1}" if random.random() < 0.8 else pick(random, kinds)
        length = pick(random, ["", "", "", "[]", f"[{pick(random, HUGE[:-1])}]", "[<=3]", "[-1]"])
        return f"{kind}{length} f{number}"

    sections = [
        (f"MSG: a/A{level}\n" if level else "")
        + "\n".join(line(level, number) for number in range(fields))
        for level in range(levels)
    ]
    if random.random() < 0.5:
        sections[0] += "\n" + definition(POSE_STAMPED).decode().partition("\n=")[0]
        sections += definition(POSE_STAMPED).decode().split(RULE)[1:]
    text = RULE.join([*sections, f"MSG: a/A{levels}\nfloat64 x"])
    language = pick(random, ["ros2msg", "ros2msg", "ros2idl"])
    path = mcap_file(
        folder / "x.mcap",
        messages=payloads(COUNT),
        schema=(POSE_STAMPED, language, text.encode()),
    )
    what = f"{levels} levels of {fields} fields, {language}"
    return Changed(what, lambda strict: read_trajectory(path, strict=strict), COUNT)


def make_folder(random: Random, folder: Path) -> Changed:
    """Put pipes, links, folders and huge numbers among the files of a bag."""
    bag = folder / "bag"
    bag.mkdir()
    file = mcap_file(bag / "x_0.mcap", messages=payloads(COUNT))
    what = []
    for _ in range(int(random.integers(1, 4))):
        name = pick(
            random,
            ["x_0.mcap", "x_1.mcap", "x_1.db3", "x²3.db3", "x.db3.zstd", "metadata.yaml", "y"],
        )
        kind = pick(random, ["pipe", "loop", "away", "folder", "device", "copy", "empty", "count"])
        path = bag / name
        what.append(f"{kind} {name}")
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif kind != "copy":
            path.unlink(missing_ok=True)
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "loop":
            path.symlink_to(path)
        elif kind == "away":
            path.symlink_to(pick(random, [folder, Path("/proc/self/mem"), folder / "missing"]))
        elif kind == "device":
            path.symlink_to(pick(random, ["/dev/zero", "/dev/full", "/dev/tty"]))
        elif kind == "folder":
            path.mkdir()
        elif kind == "copy" and not file.is_symlink() and not os.path.lexists(path):
            path.write_bytes(file.read_bytes() if file.is_file() else b"")
        elif kind == "count":
            path = bag / "metadata.yaml"
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            path.unlink(missing_ok=True)
            number = pick(random, HUGE)
            path.write_text(
                "rosbag2_bagfile_information:\n  relative_file_paths: [x_0.mcap]\n"
                "  topics_with_message_count:\n"
                f"  - topic_metadata: {{name: /pose, type: {POSE_STAMPED}}}\n"
                f"    message_count: {number:#x}\n"
            )
        elif kind == "empty":
            path.touch()
    return Changed(", ".join(what), lambda strict: read_trajectory(bag, strict=strict))
