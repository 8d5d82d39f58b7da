"""Files of rosbag2 in sqlite3, read by the rows of the requested topics.

A file is untrusted: its schema can contain SQL. Views, virtual tables and computed columns are
refused, so that no SQL of the file is executed. Pages can be linked several times, which repeats
rows: the operations and the bytes of every query are limited by the size of the file.
"""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.bags.blocks import (
    ROWS,
    Block,
    TopicSelection,
    all_connections,
    block_of,
    blocks_of,
)
from trajeval_ros.io.bags.message_definitions import Connection

Place = tuple[int, int]  # of a message in the order of reading: log time or 0, id

_UNKNOWN = -1  # counting reads the whole file
_LANGUAGES = {"ros2msg": "MSG", "ros2idl": "IDL"}
_FETCHED = 1 << 18  # bytes at once, which fit in a core's cache
_SMALLEST_ROW = 8  # bytes, of its id, lengths, topic and time
_MOST_OPERATIONS = 64  # of sqlite's virtual machine per row; a query needs about 20, with a sort
_CHECKED = 1 << 16  # operations between two checks of their number
_UNLISTED = " OR ifnull(topic_id NOT IN (SELECT id FROM topics), 1)"
_LAST_ID = "SELECT max(id) FROM messages WHERE typeof(id) = 'integer'"
_LOG_MAGICS = (0x377F0682, 0x377F0683)
_LOG_HEADER, _FRAME_HEADER = 32, 24  # bytes


class SqliteReader:
    """An open .db3 file."""

    def __init__(self, path: Path, name: str) -> None:
        """Open the file, and the write-ahead log next to it if there is one."""
        self.damage: list[str] = []  # what opening it found that can't be read, one sentence each
        self._counts: dict[int, int] | None = None
        self._path, self._name = path, name
        log = path.with_name(f"{path.name}-wal")
        has_log = log.exists() and log.stat().st_size > 0
        if not has_log:
            _refuse_truncated(path, name)
        self._size = path.stat().st_size + (log.stat().st_size if has_log else 0)
        self._checks = 0  # left for the current query
        # Without a log nothing is written, and sqlite needs no locks, which require permissions.
        uri = f"{path.resolve().as_uri()}?{'mode=ro' if has_log else 'immutable=1'}"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._database.text_factory = lambda text: text.decode(errors="replace")
        self._database.set_progress_handler(self._is_over_limit, _CHECKED)
        self._database.execute("PRAGMA trusted_schema = OFF")
        # Otherwise sqlite reads beyond a page with a damaged index of its rows.
        self._database.execute("PRAGMA cell_size_check = ON")
        if sys.version_info >= (3, 11):
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(self._size, _FETCHED))
        try:
            self.connections = self._list_connections()
        except sqlite3.Error as error:
            self._database.close()
            if has_log:
                raise InputError(
                    f"{path} was not closed, and the messages in {log.name} can't be read "
                    f"({error}); copy both to a writable folder and merge them with `sqlite3 "
                    f"{path} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
                ) from error
            raise
        if has_log and (lost := _lost_of_log(log)):
            self.damage.append(f"{log}: {lost}, their messages are missing")

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there is none."""
        first, last = self._query(
            "SELECT min(timestamp), max(timestamp) FROM messages "
            "WHERE typeof(timestamp) = 'integer'"
        ).fetchone()
        return None if first is None else (first, last)

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def blocks(
        self,
        selections: Sequence[TopicSelection],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,
    ) -> Iterator[Block]:
        """Yield the messages of some topics, of all selections in one scan of the table."""
        damage: list[str] = []
        left = self._size
        window = _Window(begin, end, in_order)
        for block in self._found(window, all_connections(selections), damage):
            left -= len(block.buffer)
            if left < 0:
                damage.append(f"{self._name} is damaged: messages overlap, the rest was not read")
                break
            yield block
        for selection in selections:
            selection.damage += damage

    def _found(
        self, window: _Window, requested: Collection[int], damage: list[str]
    ) -> Iterator[Block]:
        """Yield the messages of some topics, and add damage to the list."""
        reached: Place | None = None
        try:
            for place, block in self._scan(window, requested, damage):
                yield block
                reached = place
        except sqlite3.DatabaseError as error:
            damage.append(f"{self._name} is damaged: {error}")
            # A scan ends at the damaged page. The other rows are read one by one.
            yield from self._row_by_row(window, requested, reached, damage)

    def _scan(
        self, window: _Window, requested: Collection[int], damage: list[str]
    ) -> Iterator[tuple[Place, Block]]:
        """Yield the messages of some topics, with the place of the last one."""
        lost = 0
        for some in _groups(self._query(*window.ordered_query(requested))):
            rows = [row for row in some if row[1] in requested]
            lost += len(some) - len(rows)
            columns = ([row[number] for row in rows] for number in (1, 2, 3))
            yield window.place(some[-1][2], some[-1][0]), block_of(*columns)
        if lost:
            damage.append(f"{self._name} is damaged: {counted(lost, 'message')} of unknown topics")

    def _row_by_row(
        self, window: _Window, requested: Collection[int], reached: Place | None, damage: list[str]
    ) -> Iterator[Block]:
        """Yield the messages after a place of a damaged file that sqlite finds by their ids."""
        query, values = window.query(requested)

        def row(key: int) -> list[Any]:
            return self._readable(f"{query} AND id = ?", (*values, key))

        last: int = max((key for (key,) in self._readable(_LAST_ID) if key), default=0)
        # A row has several bytes. Therefore larger ids are gaps or damage.
        most = self._path.stat().st_size // _SMALLEST_ROW
        if last > most:
            damage.append(f"{self._name}: ids beyond {most} ignored")
        entries = (item for key in range(1, min(last, most) + 1) for item in row(key))
        places = sorted(window.place(log_time, key) for key, _, log_time, _ in entries)
        yield from blocks_of(
            item[1:]
            for place in places
            if reached is None or place > reached
            for item in row(place[1])
        )

    def _list_connections(self) -> list[Connection]:
        """Return the topics, with the definitions of their types if the file has them."""
        definitions = {}
        if self._columns("message_definitions"):
            rows = self._bounded(
                f"SELECT {_text('topic_type')}, {_text('encoding')}, "
                f"{_text('encoded_message_definition')} FROM message_definitions"
            )
            definitions = {
                name: (_LANGUAGES[encoding], text)
                for name, encoding, text in rows
                if encoding in _LANGUAGES and text.strip()
            }
        if not self._columns("topics") or not self._columns("messages"):
            raise InputError(f"{self._name} is not a bag: it has no tables of topics and messages")
        has_qos = "offered_qos_profiles" in self._columns("topics")
        rows = self._bounded(
            f"SELECT id, {_text('name')}, {_text('type')}, {_text('serialization_format')}, "
            + (_text("offered_qos_profiles") if has_qos else "''")
            + " FROM topics ORDER BY id"
        )
        return [
            Connection(
                key, name, kind, *definitions.get(kind, ("", "")), _UNKNOWN, encoding, self, qos
            )
            for key, name, kind, encoding, qos in rows
        ]

    def count(self, topic: int) -> int:
        """Return the number of messages of a topic; 0 if a page is damaged."""
        if self._counts is None:
            query = "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
            self._counts = dict(self._readable(query))
        return self._counts.get(topic, 0)

    def _columns(self, table: str) -> set[str]:
        """Return the names of a stored table's columns; refuse one that executes SQL."""
        ((count, stored),) = self._query(
            "SELECT count(*), sum(type = 'table' AND rootpage > 0 AND sql LIKE 'CREATE TABLE %') "
            "FROM sqlite_master WHERE name = ? COLLATE NOCASE",
            (table,),
        )
        columns = self._query(f"PRAGMA table_xinfo({table})").fetchall()
        if (count and not stored) or any(hidden for *_, hidden in columns):
            raise InputError(
                f"{self._name}: {table} is a view or has computed columns; export the recording "
                "as a bag with stored tables"
            )
        return {name for _, name, *_ in columns}

    def _readable(self, query: str, values: tuple[Any, ...] = ()) -> list[Any]:
        """Return the rows of a query; none if a page is damaged."""
        try:
            return self._query(query, values).fetchall()
        except sqlite3.DatabaseError:
            return []

    def _query(self, query: str, values: tuple[Any, ...] = ()) -> sqlite3.Cursor:
        """Start a query, which fails if it needs more operations than the file has rows for."""
        operations = _MOST_OPERATIONS * self._size // _SMALLEST_ROW
        self._checks = 16 + operations // _CHECKED
        return self._database.execute(query, values)

    def _is_over_limit(self) -> bool:
        self._checks -= 1
        return self._checks < 0

    def _bounded(self, query: str) -> Iterator[Any]:
        """Yield rows of text, which together are at most as large as the file."""
        left = self._size
        for row in self._query(query):
            left -= sum(len(cell) for cell in row if isinstance(cell, str))
            if left < 0:
                raise sqlite3.DatabaseError("its rows overlap")
            yield row


def _groups(rows: Iterable[tuple[Any, ...]]) -> Iterator[list[tuple[Any, ...]]]:
    """Yield rows, which end with a payload, in groups of bounded size."""
    some: list[tuple[Any, ...]] = []
    left = _FETCHED
    for row in rows:
        some.append(row)
        left -= len(row[-1])
        if left <= 0 or len(some) == ROWS:
            yield some
            some, left = [], _FETCHED
    if some:
        yield some


@dataclass(frozen=True)
class _Window:
    """The rows of the requested topics that are read, and their order."""

    begin: int | None  # the first requested log time, ns; None means all
    end: int | None  # the first log time after the requested ones, ns; None means all
    in_order: bool  # whether they are read in order of their log times

    def query(self, requested: Collection[int], others: str = "") -> tuple[str, tuple[Any, ...]]:
        """Return the query of the requested messages, and its values."""
        query = (
            "SELECT id, topic_id, CAST(ifnull(timestamp, 0) AS INTEGER), "
            "ifnull(CAST(data AS BLOB), x'') FROM messages "
            f"WHERE (topic_id IN ({','.join('?' * len(requested))}){others})"
        )
        values: tuple[Any, ...] = tuple(requested)
        if self.begin is not None:
            query, values = f"{query} AND timestamp >= ?", (*values, self.begin)
        if self.end is not None:
            query, values = f"{query} AND timestamp < ?", (*values, self.end)
        return query, values

    def ordered_query(self, requested: Collection[int]) -> tuple[str, tuple[Any, ...]]:
        """Return the query, in order, of these messages and those of topics that do not exist."""
        query, values = self.query(requested, _UNLISTED)
        # The order of time reads pages in random order. Other callers read rows as stored.
        return f"{query} ORDER BY {'timestamp, id' if self.in_order else 'id'}", values

    def place(self, log_time: int, key: int) -> Place:
        """Return where in the order a message is."""
        return (log_time if self.in_order else 0, key)


def _text(column: str) -> str:
    """Return a column as text: every row of sqlite can have any type, such as a blob."""
    return f"ifnull(CAST({column} AS TEXT), '')"


def _lost_of_log(log: Path) -> str:
    """Return a sentence on pages of the log that sqlite did not use, which it does not report.

    See sqlite's file format, 4.1 and 4.4. The log is a header and frames of one page. The index
    next to it has the number of committed frames.
    """
    with log.open("rb") as file:
        header = file.read(_LOG_HEADER)
        if int.from_bytes(header[:4], "big") not in _LOG_MAGICS or len(header) < _LOG_HEADER:
            return "none of its pages is readable"
        frame = _FRAME_HEADER + int.from_bytes(header[8:12], "big")
        size = log.stat().st_size
        count = 0
        while _LOG_HEADER + (count + 1) * frame <= size:
            file.seek(_LOG_HEADER + count * frame + 8)
            if file.read(8) != header[16:24]:  # a frame of an older log
                break
            count += 1
    index, used = log.with_name(f"{log.name.removesuffix('-wal')}-shm"), 0
    if index.exists():  # it does not, if the database is not in the mode WAL
        with index.open("rb") as file:
            used = int.from_bytes(file.read(20)[16:], sys.byteorder)
    return f"{count - used} of its {count} pages are unreadable" if used < count else ""


def _refuse_truncated(path: Path, name: str) -> None:
    """Raise InputError if sqlite's header counts more pages than the file has.

    With missing pages, sqlite often returns fewer messages without an error.
    """
    with path.open("rb") as file:
        header = file.read(100).ljust(100, b"\0")
    size_field = int.from_bytes(header[16:18], "big")
    page_size = 65536 if size_field == 1 else size_field
    pages = int.from_bytes(header[28:32], "big")
    is_valid = header[24:28] == header[92:96]  # older versions of sqlite do not update the count
    size = path.stat().st_size
    if is_valid and size < pages * page_size:
        raise InputError(
            f"{name} is truncated: it has {size} of {pages * page_size} bytes; copy it again, or "
            "recover the data with the sqlite3 command `.recover`"
        )
