"""Files of rosbag2 in sqlite3, read by the rows of the wanted topics."""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.blocks import ROWS, Block, block_of, blocks_of
from trajeval_ros.io.bags.metadata import qos_of
from trajeval_ros.io.bags.selection import TopicSelection, all_connections

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Place = tuple[int, int]  # of a message in the order of reading: log time or 0, id

_UNKNOWN = -1  # counting reads the whole file
_FETCHED = 1 << 18  # bytes at once, which fit in a core's cache
_LOG_MAGICS = (0x377F0682, 0x377F0683)
_LOG_HEADER, _FRAME_HEADER = 32, 24  # bytes
_SMALLEST_ROW = 8  # bytes, of its id, lengths, topic and time
_FEW = 16  # rows at first, until their size is known


class SqliteReader:
    """An open .db3 file.

    Attributes:
        connections: Its topics.
        damage: What opening it found that can't be read, one sentence each.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Open the file, and the write-ahead log next to it if there is one.

        Args:
            path: The file.
            name: Its name in messages.

        Raises:
            InputError: It is damaged, or its log can't be read.
        """
        self.damage: list[str] = []
        self._counts: dict[int, int] | None = None
        self._path, self._name = path, name
        log = path.with_name(f"{path.name}-wal")
        has_log = log.exists() and log.stat().st_size > 0
        if not has_log:
            refuse_truncated(path, name)
        # Without a log nothing is written, and sqlite needs no locks, which require permissions.
        mode = "mode=ro" if has_log else "immutable=1"
        uri = f"{path.resolve().as_uri()}?{mode}"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._database.text_factory = lambda text: text.decode(errors="replace")
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
        if has_log and (lost := _lost_of(log)):
            self.damage.append(f"{log}: {lost}, their messages are missing")

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there is none."""
        first, last = self._database.execute(
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
    ) -> Iterator[tuple[Sequence[TopicSelection], Block]]:
        """Yield the messages of some topics, of all selections in one scan of the table."""
        yield from self._blocks(selections, _Window(begin, end, in_order), None)

    def _blocks(
        self, selections: Sequence[TopicSelection], window: _Window, reached: Place | None
    ) -> Iterator[tuple[Sequence[TopicSelection], Block]]:
        """Yield the messages after a place; None means all."""
        query, values = window.query(all_connections(selections))
        try:
            rows = self._database.execute(*window.after(query, values, reached))
            count = _FEW
            while some := rows.fetchmany(count):
                keys, topics, log_times, payloads = zip(*some, strict=True)
                block = block_of(topics, log_times, payloads)
                yield selections, block
                reached = window.place(log_times[-1], keys[-1])
                size = len(block.buffer) // len(block)
                count = min(ROWS, 1 + _FETCHED // max(size, 1))
        except sqlite3.DatabaseError as error:
            said = f"{self._name} is damaged: {error}"
        else:
            return
        if len(selections) > 1:  # the damage can be of one of them only
            for selection in selections:
                yield from self._blocks([selection], window, reached)
            return
        (selection,) = selections
        selection.damage.append(said)
        # The same query reaches the damaged page again. The other rows are read one by one.
        left = [
            window.place(log_time, key)
            for log_time, key in self._one_by_one(query, values, selection)
        ]
        for block in blocks_of(
            row[1:]
            for each in sorted(left)
            if reached is None or each > reached
            for row in self._row(query, values, each[1])
        ):
            yield selections, block

    def _one_by_one(
        self, query: str, values: tuple[Any, ...], selection: TopicSelection
    ) -> Iterator[tuple[int, int]]:
        """Yield log time and id of all readable messages in a damaged file."""
        last = self.rows
        # A row has several bytes. Therefore larger ids are gaps or damage.
        most = self._path.stat().st_size // _SMALLEST_ROW
        if last > most:
            selection.damage.append(f"{self._name}: ids beyond {most} ignored")
            last = most
        for key in range(1, last + 1):
            yield from ((row[2], row[0]) for row in self._row(query, values, key))

    def _row(self, query: str, values: tuple[Any, ...], key: int) -> list[Any]:
        try:
            return self._database.execute(f"{query} AND id = ?", (*values, key)).fetchall()
        except sqlite3.DatabaseError:
            return []

    def _list_connections(self) -> list[Connection]:
        """Return the topics, with the definitions of their types if the file has them."""
        from rosbags.interfaces import (
            Connection,
            ConnectionExtRosbag2,
            MessageDefinition,
            MessageDefinitionFormat,
        )

        formats = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
        texts = {}
        if self._columns("message_definitions"):
            rows = self._database.execute(
                f"SELECT {_text('topic_type')}, {_text('encoding')}, "
                f"{_text('encoded_message_definition')} FROM message_definitions"
            )
            texts = {
                name: MessageDefinition(formats[encoding], text)
                for name, encoding, text in rows
                if encoding in formats and text.strip()
            }
        if not self._columns("topics") or not self._columns("messages"):
            raise InputError(f"{self._name} is not a bag: it has no tables of topics and messages")
        has_qos = "offered_qos_profiles" in self._columns("topics")
        rows = self._database.execute(
            f"SELECT id, {_text('name')}, {_text('type')}, {_text('serialization_format')}, "
            + (_text("offered_qos_profiles") if has_qos else "''")
            + " FROM topics ORDER BY id"
        )
        none = MessageDefinition(MessageDefinitionFormat.NONE, "")
        return [
            Connection(
                key,
                name,
                kind,
                texts.get(kind, none),
                "",
                _UNKNOWN,
                ConnectionExtRosbag2(serialization, qos_of(qos)),
                self,
            )
            for key, name, kind, serialization, qos in rows
        ]

    @cached_property
    def rows(self) -> int:
        """The largest id of a message, which is at least their number; 0 if it can't be read."""
        try:
            ((last,),) = self._database.execute("SELECT max(id) FROM messages").fetchall()
        except sqlite3.DatabaseError:
            return 0
        return last or 0

    def count(self, topic: int) -> int:
        """Return the number of messages of a topic; 0 if a page is damaged."""
        if self._counts is None:
            query = "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
            try:
                self._counts = dict(self._database.execute(query).fetchall())
            except sqlite3.DatabaseError:
                self._counts = {}
        return self._counts.get(topic, 0)

    def _columns(self, table: str) -> set[str]:
        rows = self._database.execute(f"PRAGMA table_info({table})")
        return {name for _, name, *_ in rows}


@dataclass(frozen=True)
class _Window:
    """The rows of the requested topics that are read, and their order.

    Attributes:
        begin: The first requested log time, ns; None means all.
        end: The first log time after the requested ones, ns; None means all.
        in_order: Whether they are read in order of their log times.
    """

    begin: int | None
    end: int | None
    in_order: bool

    def query(self, wanted: Collection[int]) -> tuple[str, tuple[Any, ...]]:
        """Return the query of the requested messages, and its values."""
        query = (
            "SELECT id, topic_id, CAST(ifnull(timestamp, 0) AS INTEGER), "
            "ifnull(CAST(data AS BLOB), x'') FROM messages "
            f"WHERE topic_id IN ({','.join('?' * len(wanted))})"
        )
        values: tuple[Any, ...] = tuple(wanted)
        if self.begin is not None:
            query, values = f"{query} AND timestamp >= ?", (*values, self.begin)
        if self.end is not None:
            query, values = f"{query} AND timestamp < ?", (*values, self.end)
        return query, values

    def after(
        self, query: str, values: tuple[Any, ...], place: Place | None
    ) -> tuple[str, tuple[Any, ...]]:
        """Return the query of the messages after a place, in order, and its values."""
        if place is not None and self.in_order:
            query, values = f"{query} AND (timestamp, id) > (?, ?)", (*values, *place)
        elif place is not None:
            query, values = f"{query} AND id > ?", (*values, place[1])
        # The order of time reads pages in random order. Other callers read rows as stored.
        return f"{query} ORDER BY {'timestamp, id' if self.in_order else 'id'}", values

    def place(self, log_time: int, key: int) -> Place:
        """Return where in the order a message is."""
        return (log_time if self.in_order else 0, key)


def _text(column: str) -> str:
    """Return a column as text: every row of sqlite can have any type, such as a blob."""
    return f"ifnull(CAST({column} AS TEXT), '')"


def _lost_of(log: Path) -> str:
    """Return a sentence on pages of the log that sqlite did not use, which it does not report.

    See sqlite's file format, 4.1 and 4.4. The log is a header and frames of one page. The index
    next to it has the number of committed frames.
    """
    with log.open("rb") as file:
        header = file.read(_LOG_HEADER)
        if int.from_bytes(header[:4], "big") not in _LOG_MAGICS or len(header) < _LOG_HEADER:
            return "none of its pages could be used"
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
    return f"{count - used} of its {count} pages could not be used" if used < count else ""


def refuse_truncated(path: Path, name: str) -> None:
    """Raise InputError if sqlite's header counts more pages than the file has.

    With missing pages, sqlite often returns fewer messages without an error.
    """
    with path.open("rb") as file:
        header = file.read(100).ljust(100, b"\0")
    page_size, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    page_size = 65536 if page_size == 1 else page_size
    is_valid = header[24:28] == header[92:96]  # older versions of sqlite do not update the count
    size = path.stat().st_size
    if is_valid and size < pages * page_size:
        raise InputError(
            f"{name} is truncated: it has {size} of {pages * page_size} bytes; copy it again, or "
            "recover the data with the sqlite3 command `.recover`"
        )
