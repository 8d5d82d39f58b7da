"""A comparison in shards, for arrays of jobs: each job evaluates a part, then they are merged.

Merged tables are identical, byte for byte, to the tables of a single job: both are made from the
same records by the same code.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from trajeval_ros.batch.finished_comparison import FinishedComparison, FinishedRun
from trajeval_ros.batch.plan import Plan, PlannedRun
from trajeval_ros.batch.pyarrow_package import load_pyarrow
from trajeval_ros.batch.record_store import RECORDS, SUFFIX, RecordStore
from trajeval_ros.batch.records import Record
from trajeval_ros.batch.source_hash import hash_of_package
from trajeval_ros.exceptions import InputError, SettingsError, reason_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.json_file import mapping_in
from trajeval_ros.io.schema import require_schema
from trajeval_ros.io.writing import refused_by_disk, write_whole

SHARD = "shard.parquet"
SCHEMA = "trajeval-shard/1"
_TEXTS = (
    "algorithm", "sequence", "trial", "groundtruth", "estimate", "missing", "planned_key", "key",
    "reason",
)  # fmt: skip
_COLUMNS = {"place": "int64", **dict.fromkeys(_TEXTS, "string"), "own_coverage": "float64"}
_RUN = _TEXTS[:6]
_HEAD = ("shard", "title", "settings", "runs", "plan", "package")
_MEND = "run the shards again, all from the same file with the same version"


@dataclass(frozen=True)
class Shard:
    """One of several parts of a comparison.

    Attributes:
        number: Its number, from 1.
        count: Number of shards.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read "3/16".

        Raises:
            SettingsError: It has another form.
        """
        match = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise SettingsError(
                f"--shard {text} is not valid; write I/N with I from 1 to N, such as 3/16"
            )
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def places(self, plan: Plan) -> list[int]:
        """Return the places of its runs in the plan, in order.

        The sizes of shards differ by at most one run. Runs of a sequence stay together, because
        they share its groundtruth. With a common time span, they are in one shard.
        """
        order = sorted(
            range(len(plan.runs)),
            key=lambda place: (plan.runs[place].sequence, plan.runs[place].groundtruth),
        )
        first: dict[str, int] = {}
        own = []
        for position, place in enumerate(order):
            if plan.common_time_span:
                position = first.setdefault(plan.runs[place].sequence, position)
            if position * self.count // len(order) == self.number - 1:
                own.append(place)
        return sorted(own)

    def of(self, plan: Plan) -> Plan:
        """Return the part of the plan with its runs."""
        return replace(plan, runs=tuple(plan.runs[place] for place in self.places(plan)))


def write_shard(folder: Path, shard: Shard, plan: Plan, finished: FinishedComparison) -> None:
    """Write the status of the runs of a shard, for merging.

    Args:
        folder: Folder of the shard.
        shard: The shard.
        plan: Plan of all shards together.
        finished: Runs of the shard.

    Raises:
        InputError: It can't be written.
    """
    arrow, parquet = load_pyarrow()
    rows = [
        {
            **{name: getattr(each.run, name) for name in _RUN},
            **{name: value for name, value in each._asdict().items() if name != "run"},
            "place": place,
        }
        for place, each in zip(shard.places(plan), finished.runs, strict=True)
    ]
    head = {
        "schema": SCHEMA,
        "shard": str(shard),
        "title": finished.title,
        "settings": json.dumps(finished.settings),
        "runs": str(len(plan.runs)),
        "plan": _hash_of(plan),
        "package": hash_of_package(),
    }
    schema = arrow.schema(
        [(name, getattr(arrow, kind)()) for name, kind in _COLUMNS.items()],
        metadata={f"trajeval.{name}": value for name, value in head.items()},
    )
    table = arrow.Table.from_pylist(rows, schema=schema)
    write_whole(folder / SHARD, lambda temporary: parquet.write_table(table, temporary))


def _hash_of(plan: Plan) -> str:
    """Return a hash of a plan without the paths, which may differ between hosts."""
    digest = hashlib.sha256(json.dumps(plan.settings).encode())
    for run in plan.runs:
        part = (run.algorithm, run.sequence, run.trial, bool(run.missing))
        digest.update(json.dumps(part).encode())
    return digest.hexdigest()


def merged(folders: Sequence[Path]) -> FinishedComparison:
    """Return the comparison of all shards together.

    Args:
        folders: Folders of all shards.

    Raises:
        InputError: A folder is not a shard or belongs to another comparison, or a shard is given
            twice or missing.
    """
    heads = {folder: _head_of(folder) for folder in folders}
    first, *others = heads
    for folder in others:
        for name, what in (
            ("title", "title"), ("package", "version of trajeval"), ("settings", "settings"),
            ("plan", "runs"), ("runs", "runs"),
        ):  # fmt: skip
            if heads[folder][name] != heads[first][name]:
                raise InputError(f"{first} and {folder} have different {what}; {_MEND}")
    _require_all(heads)
    runs: dict[int, FinishedRun] = {}
    for folder in folders:
        runs.update(_runs_in(folder))
    total = int(heads[first]["runs"])
    missing = next((place for place in range(total) if place not in runs), None)
    if missing is not None:
        raise InputError(f"run {missing + 1} of {total} is missing in the shards; {_MEND}")
    if len(runs) > total:
        raise InputError(
            f"the shards have {counted(len(runs), 'run')} instead of {total}; {_MEND}"
        )
    settings = mapping_in(heads[first]["settings"])
    assert settings is not None
    return FinishedComparison(
        heads[first]["title"], settings, [runs[place] for place in range(total)]
    )


def write_merged(finished: FinishedComparison, folders: Sequence[Path], output: Path) -> None:
    """Write the tables of a comparison in shards, and add the records of the shards.

    Args:
        finished: The comparison, from `merged`.
        folders: Folders of all shards.
        output: Folder for the comparison.

    Raises:
        InputError: Records can't be read, or the output can't be written.
    """
    with refused_by_disk(f"the folder {output / RECORDS}"):
        (output / RECORDS).mkdir(parents=True, exist_ok=True)
    _adopt_records(folders, output / RECORDS)
    if finished.is_in(output):
        return
    records = RecordStore(output / RECORDS)

    def record_of(each: FinishedRun) -> Record:
        record = records.read(each.key)
        if record is None:
            raise InputError(f"the record of {each.run.name} can't be read; run its shard again")
        return record

    finished.write_tables(output, record_of)


def _head_of(folder: Path) -> dict[str, str]:
    path = folder / SHARD
    with _open_table(path) as table:
        metadata = table.schema_arrow.metadata or {}
        kinds = {each.name: str(each.type) for each in table.schema_arrow}
    text = {key.decode(errors="replace"): value.decode(errors="replace")
            for key, value in metadata.items()}  # fmt: skip
    head = {key.removeprefix("trajeval."): value for key, value in text.items()}
    require_schema(path, head.get("schema"), SCHEMA, "shard of a comparison", "run it again")
    if not _is_complete(head) or any(
        kinds.get(name) != kind.replace("float64", "double") for name, kind in _COLUMNS.items()
    ):
        raise _damaged(path)
    return head


def _is_complete(head: dict[str, str]) -> bool:
    """Return whether the head of a shard has all fields, and valid ones."""
    if not set(_HEAD) <= head.keys() or mapping_in(head["settings"]) is None:
        return False
    try:
        Shard.parse(head["shard"])
        return int(head["runs"]) > 0
    except (SettingsError, ValueError):
        return False


def _damaged(path: Path) -> InputError:
    return InputError(f"{path} is damaged; run that shard again")


@contextmanager
def _open_table(path: Path) -> Iterator[Any]:
    """Yield the table of a shard; errors in the block name it once.

    Raises:
        InputError: There is none, or it can't be read.
    """
    _, parquet = load_pyarrow()
    try:
        file = path.open("rb")
    except FileNotFoundError as error:
        raise InputError(
            f"no finished shard in {path.parent}; give the --output of a finished trajeval "
            "compare --shard"
        ) from error
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    try:
        with file, parquet.ParquetFile(file) as table:
            yield table
    except (OSError, ValueError, LookupError) as error:
        raise _damaged(path) from error


def _require_all(heads: dict[Path, dict[str, str]]) -> None:
    """Check that every shard is given once."""
    of_number: dict[int, Path] = {}
    counts = {Shard.parse(head["shard"]).count for head in heads.values()}
    if len(counts) > 1:
        totals = " and ".join(map(str, sorted(counts)))
        raise InputError(f"the shards have different totals, {totals}; {_MEND}")
    for folder, head in heads.items():
        number = Shard.parse(head["shard"]).number
        if number in of_number:
            raise InputError(
                f"{of_number[number]} and {folder} are both shard {head['shard']}; give only one"
            )
        of_number[number] = folder
    (count,) = counts
    missing = [f"{each}/{count}" for each in range(1, count + 1) if each not in of_number]
    if missing:
        some = ", ".join(missing[:10]) + (", …" if len(missing) > 10 else "")
        raise InputError(
            f"missing: {some} of {counted(count, 'shard')}; run them, or give their folders"
        )


def _runs_in(folder: Path) -> dict[int, FinishedRun]:
    """Return the runs of a shard by their places in the plan."""
    with _open_table(folder / SHARD) as table:
        return {
            row["place"]: _finished(row)
            for batch in table.iter_batches(columns=list(_COLUMNS))
            for row in batch.to_pylist()
        }


def _finished(row: dict[str, Any]) -> FinishedRun:
    if any(row[name] is None for name in _TEXTS):
        raise ValueError("a text is missing")
    run = PlannedRun(**{name: row[name] for name in _RUN})
    return FinishedRun(run, row["planned_key"], row["key"], row["reason"], row["own_coverage"])


def _adopt_records(folders: Sequence[Path], records: Path) -> None:
    """Add the records of shards to another folder: as links, or as copies on another disk."""
    for folder in folders:
        name = _head_of(folder)["shard"].replace("/", "-of-")
        for file in sorted((folder / RECORDS).glob(f"*{SUFFIX}")):
            write_whole(records / f"shard-{name}-{file.name}", partial(_link, file))


def _link(file: Path, other: Path) -> None:
    """Link a file, or copy it if that is not possible."""
    other.unlink()
    try:
        os.link(file, other)
    except OSError:
        shutil.copyfile(file, other)
