"""Messages of a sqlite3 file, read from its pages as columns instead of row by row.

The format is described in sqlite's "Database File Format", sections 1.3 (header), 1.6 (pages) and
2.1 (records). Only pages as recorders write them are read. Any other content ends the messages,
and sqlite reads the rest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.io.bags.blocks import BYTES, Block
from trajeval_ros.io.bags.byte_buffers import Buffer, gather
from trajeval_ros.io.bags.byte_source import GAP, ByteSource
from trajeval_ros.io.bags.selection import are_of

_INTERIOR, _LEAF = 5, 13  # first byte of a table's page
_INTERIOR_HEADER, _LEAF_HEADER = 12, 8  # bytes
_CHILD = 4  # bytes, of the number of a page
_DEEPEST = 20  # levels of pages
_LONGEST_VARINT = 8  # bytes; longer ones are negative or above 2^56
_MARGIN = 35  # bytes; a record in one page is smaller than the page by at least this
_BLOB = 12  # type of an empty blob; each byte adds 2
_ONE = 9  # type of the integer 1, which has no bytes
_BYTES_OF_INTEGER = np.full(256, -1)  # by type; -1 is no integer
_BYTES_OF_INTEGER[[1, 2, 3, 4, 5, 6, 8, _ONE]] = 1, 2, 3, 4, 6, 8, 0, 0


class MessagePages:
    """The pages of a table with the columns id (which numbers rows), topic, time and payload."""

    def __init__(self, source: ByteSource, root: int) -> None:
        """Read the header of the file.

        Args:
            source: The file.
            root: Number of the table's first page.
        """
        header = source.read(0, 100)
        self._page_size = page_size_of(header)
        self._usable = self._page_size - header[20]
        self._count = source.size // self._page_size
        self._source, self._root = source, root

    def blocks(self, topics: Collection[int]) -> Iterator[tuple[int, Block]]:
        """Yield the last id of some pages, and their messages of some topics, in order of ids."""
        last = -1
        for numbers in self._leaves(np.array([self._root]), _DEEPEST):
            rows = self._rows(numbers)
            if rows is None:
                return
            ids, is_long, block = rows
            wanted = are_of(block.connections, topics)
            # Ids ascend. Otherwise, a damaged file could lead to the same page again and again.
            if ids[0] <= last or (np.diff(ids) <= 0).any() or (is_long & wanted).any():
                return
            last = int(ids[-1])
            yield last, block[wanted]

    def _leaves(self, numbers: Indices, levels: int) -> Iterator[Indices]:
        """Yield the pages with rows below some pages, in order; none for one of another kind."""
        header = self._read(numbers[:1])
        if header is None or not levels:
            yield numbers[:0]
        elif header[0][0] == _LEAF:
            most = max(2 * BYTES // self._page_size, 1)
            for begin in range(0, len(numbers), most):
                yield numbers[begin : begin + most]
        else:
            for row in range(len(numbers)):
                yield from self._leaves(self._children(numbers[row : row + 1]), levels - 1)

    def _children(self, number: Indices) -> Indices:
        """Return the children of an interior page, in order; none for a page of another kind."""
        page = self._read(number)
        cells = None if page is None else _cells(*page, self._usable, _INTERIOR)
        if page is None or cells is None:
            return number[:0]
        # The last child is in the header.
        places = np.append(cells[0], _LEAF_HEADER)
        children: Indices = gather(page[0], places, np.dtype(">u4")).astype(np.int64)
        return children

    def _rows(self, numbers: Indices) -> tuple[Indices, Booleans, Block] | None:
        """Return ids (N,), which messages are longer than a page (N,), and the messages.

        None if a page has anything else than such rows.
        """
        pages = self._read(numbers)
        cells = None if pages is None else _cells(*pages, self._usable, _LEAF)
        if pages is None or cells is None:
            return None
        (buffer, _), (begins, ends) = pages, cells
        # Of a record: its size and id; the size of its header and the types of the columns, of
        # which the id's is that of NULL; the columns.
        sizes, places = _varints(buffer, begins)
        ids, records = _varints(buffer, places)
        header = buffer.take(records[:, None] + np.arange(4), mode="clip")
        header_size, id_type, topic_type, time_type = header.astype(np.int64).T
        payload_type, topics = _varints(buffer, records + 4)
        topic_bytes, time_bytes = _BYTES_OF_INTEGER[topic_type], _BYTES_OF_INTEGER[time_type]
        times = topics + topic_bytes
        payloads = times + time_bytes
        payload_sizes = (payload_type - _BLOB) // 2
        is_long = sizes > self._usable - _MARGIN
        is_plain = (
            (topics - records == header_size)
            & (id_type == 0)
            & (topic_bytes >= 0)
            & (time_bytes >= 0)
            & (payload_type >= _BLOB)
            & (payload_type % 2 == 0)
            & (payloads + payload_sizes - records == sizes)
            & (np.where(is_long, payloads, payloads + payload_sizes) <= ends)
        )
        if not is_plain.all():
            return None
        log_times = _integers(buffer, times, time_type)
        connections = _integers(buffer, topics, topic_type)
        earliest = int(log_times.min())
        block = Block(earliest, connections, log_times, buffer, payloads, payload_sizes)
        return ids, is_long, block

    def _read(self, numbers: Indices) -> tuple[Buffer, Indices] | None:
        """Return bytes that contain some pages (P,), and where the pages begin (P,).

        None if the file does not have them.
        """
        if not len(numbers) or numbers.min() < 2 or numbers.max() > self._count:
            return None
        steps = np.diff(numbers)
        firsts = np.append(0, 1 + np.flatnonzero((steps < 1) | (steps * self._page_size > GAP)))
        lasts = np.append(firsts[1:], len(numbers)) - 1
        offsets = (numbers - 1) * self._page_size
        ends = offsets[lasts] + self._page_size
        ranges = zip(offsets[firsts].tolist(), (ends - offsets[firsts]).tolist(), strict=True)
        data = b"".join(self._source.read_all(list(ranges)))
        sizes = ends - offsets[firsts]
        if len(data) < sizes.sum():
            return None
        before = np.repeat(np.cumsum(sizes) - sizes - offsets[firsts], lasts + 1 - firsts)
        return np.frombuffer(data, dtype=np.uint8), offsets + before


def page_size_of(header: bytes) -> int:
    """Return the bytes of a page, from the first bytes of a file."""
    size = int.from_bytes(header[16:18], "big")
    return 65536 if size == 1 else size


def _cells(
    buffer: Buffer, pages: Indices, usable: int, kind: int
) -> tuple[Indices, Indices] | None:
    """Return where the cells of pages begin, and where the pages of these cells end, (N,).

    Args:
        buffer: (B,) bytes with the pages.
        pages: (P,), where the pages begin.
        usable: Bytes of a page that are used.
        kind: First byte of the pages.

    Returns:
        None if a page is of another kind, has no cells, or one of them is not in the page.
    """
    header = _LEAF_HEADER if kind == _LEAF else _INTERIOR_HEADER
    counts = gather(buffer, pages + 3, np.dtype(">u2")).astype(np.int64)
    most = int(counts.max())
    if (buffer[pages] != kind).any() or not counts.all() or header + 2 * most > usable:
        return None
    places = pages[:, None] + header + 2 * np.arange(most)
    pointers = gather(buffer, places.ravel(), np.dtype(">u2")).astype(np.int64)
    begins = pointers.reshape(places.shape)
    used = np.arange(most) < counts[:, None]
    if (begins[used] > usable - _CHILD).any():
        return None
    return (pages[:, None] + begins)[used], np.repeat(pages + usable, counts)


def _varints(buffer: Buffer, places: Indices) -> tuple[Indices, Indices]:
    """Return integers (N,) of variable length, -1 for long ones, and where they end (N,).

    A byte has 7 bits of the integer, most significant first; its highest bit is set if another
    byte follows.
    """
    values = np.zeros(len(places), dtype=np.int64)
    goes_on = np.ones(len(places), dtype=bool)
    for _ in range(_LONGEST_VARINT):
        current = buffer.take(places, mode="clip")
        values = np.where(goes_on, values << 7 | current & 127, values)
        places = places + goes_on
        goes_on &= current > 127
        if not goes_on.any():
            return values, places
    return np.where(goes_on, -1, values), places


def _integers(buffer: Buffer, places: Indices, types: Indices) -> Indices:
    """Return integers (N,) of some types at the places (N,), which are not at the beginning."""
    values: Indices = (types == _ONE).astype(np.int64)
    for kind in set(types.tolist()):
        size = int(_BYTES_OF_INTEGER[kind])
        if size:
            rows = types == kind
            # The word that ends with the integer; the shifts extend its sign.
            words = gather(buffer, places[rows] + size - 8, np.dtype(">i8")).astype(np.int64)
            unused = 64 - 8 * size
            values[rows] = words << unused >> unused
    return values
