"""Files of rosbag2 in sqlite3, read by the rows of the wanted topics."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.blocks import ROWS, Block, block_of, blocks_of
from trajeval_ros.io.bags.byte_source import LocalFile
from trajeval_ros.io.bags.metadata import qos_of
from trajeval_ros.io.bags.selection import TopicSelection, all_connections
from trajeval_ros.io.bags.sqlite_losses import lost_of_log, refuse_truncated
from trajeval_ros.io.bags.sqlite_pages import MessagePages

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Place = tuple[int, int]  # of a message in the order of reading: log time or 0, id

_UNKNOWN = -1  # counting reads the whole file
_FETCHED = 1 << 18  # bytes at once, which fit in a core's cache
_SMALLEST_ROW = 8  # bytes, of its id, lengths, topic and time
_COLUMNS = [(name, "INTEGER") for name in ("id", "topic_id", "timestamp")] + [("data", "BLOB")]
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
        has_log = self._has_log = log.exists() and log.stat().st_size > 0
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
        if has_log and (lost := lost_of_log(log)):
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
        wanted = all_connections(selections)
        if reached is None and not window.in_order:
            for key, block in self._paged(wanted):
                reached = window.place(0, key)
                if len(part := block.within(window.begin, window.end)):
                    yield selections, part
        query, values = window.query(wanted)
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

    def _paged(self, wanted: Collection[int]) -> Iterator[tuple[int, Block]]:
        """Yield messages of some topics by pages, as far as these are as recorders write them.

        Each block comes with the last id that was read. sqlite has to read the other messages.
        """
        if self._has_log or list(self._columns("messages").items()) != _COLUMNS:
            return
        roots = self._database.execute(
            "SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = 'messages'"
        ).fetchall()
        file = LocalFile(self._path)
        try:
            for (root,) in roots:
                yield from MessagePages(file, root).blocks(wanted)
        except OSError:  # a part of the disk can't be read, and sqlite reads what is around it
            return
        finally:
            file.close()

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

    def _columns(self, table: str) -> dict[str, str]:
        """Return the types of a table's columns by name, in order; none if there is no table."""
        rows = self._database.execute(f"PRAGMA table_info({table})")
        return {name: kind for _, name, kind, *_ in rows}


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
