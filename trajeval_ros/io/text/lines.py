"""Lines of a text file, whatever its compression, encoding and line ends."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import IO

from trajeval_ros.exceptions import InputError

Advance = Callable[[int, int], None]
Head = tuple[list[str], bool]  # first lines of a file, and whether these are all

HEAD = 1 << 16  # bytes from which a file is recognised
_BUFFER = 1 << 18
_LONGEST_LINE = 1 << 19
_MOST = 1 << 32  # bytes after decompression
# Compression by magic: the modules that read it, of which one is installed but for zstd.
_PACKED = {
    b"\x1f\x8b": ("gzip",),
    b"BZh": ("bz2",),
    b"\xfd7zXZ\0": ("lzma",),
    b"\x28\xb5\x2f\xfd": ("compression.zstd", "backports.zstd", "zstandard"),
}
_UTF16, _BOM = (b"\xff\xfe", b"\xfe\xff"), b"\xef\xbb\xbf"
# Beginnings of files that are no text with poses, and what to do with them.
_REFUSED = {
    rb"\s*\Z": "empty; check that the recording has poses",
    rb"version https://git-lfs\.github\.com/": "a pointer of Git LFS without the data; get them: "
    "git lfs pull --include {name}",
    rb"\x89PNG": "a picture (PNG); give a file with poses",
    rb"\xff\xd8\xff": "a picture (JPEG); give a file with poses",
    rb"GIF8": "a picture (GIF); give a file with poses",
    rb"PK\x03\x04": "a zip archive; unpack it, and give the file with poses",
    rb"ARROW1|PAR1": 'Arrow or Parquet; convert it: python -c "import pandas as p; '
    "p.read_feather('IN').to_csv('OUT.csv', index=False)\" (read_parquet for Parquet)",
    rb"\s*<": "XML; convert it to a table with a header, such as t,latitude,longitude,height",
    rb"[^\n]*\0": "a binary file of unknown format, neither text nor a bag",
}


class _Watched(io.BufferedIOBase):
    """A binary stream that reports progress and refuses zero bytes and endless lines."""

    def __init__(self, path: Path, stream: IO[bytes], inner: IO[bytes], advance: Advance | None):
        self._path, self._stream, self._inner, self._advance = path, stream, inner, advance
        self._total, self._line, self._read = path.stat().st_size, 0, 0
        self.first = b""  # bytes before the next ones, which the caller has returned
        self.zeros = False  # whether zero bytes belong to the encoding

    def readable(self) -> bool:
        return True

    def close(self) -> None:
        self._stream.close()
        self._inner.close()
        super().close()

    def read1(self, size: int | None = -1) -> bytes:  # noqa: ARG002 - TextIOWrapper's request
        """Return the next block, of any size: small ones are slow."""
        if self.first:
            block, self.first = self.first, b""
            return block
        try:
            block = self._stream.read(_BUFFER)
        except Exception as error:  # zlib.error, lzma.LZMAError and ZstdError have no common base
            raise InputError(f"{self._path} is damaged: {error}") from error
        if b"\0" in block and not self.zeros and not block.startswith(_UTF16):
            end = self._read + block.index(b"\0")
            with _opened(self._path)[0] as file:  # to count all lines would take time
                parts = (file.read(min(_BUFFER, end - at)) for at in range(0, end, _BUFFER))
                line = 1 + sum(part.count(b"\n") for part in parts)
            raise InputError(
                f"{self._path}, line {line}: contains zero bytes, as after a crash of the "
                "recorder; correct or remove the line"
            )
        self._read += len(block)
        last = max(block.rfind(b"\n"), block.rfind(b"\r"))
        self._line = len(block) - last - 1 + (self._line if last < 0 else 0)
        if self._line > _LONGEST_LINE:
            raise InputError(f"{self._path}: a line has more than {_LONGEST_LINE} bytes")
        if self._read > _MOST and self._stream is not self._inner:
            raise InputError(f"{self._path} has more than 4 GiB when decompressed; decompress it")
        if self._advance is not None:
            self._advance(self._inner.tell(), self._total)
        return block

    read = read1


def open_lines(path: Path, advance: Advance | None = None) -> io.TextIOWrapper:
    """Return the lines of a text file, as text of one byte per character."""
    stream, inner = _opened(path)
    raw = _Watched(path, stream, inner, advance)
    try:
        first = raw.read1()
    except InputError:
        raw.close()
        raise
    raw.zeros = first[:2] in _UTF16
    raw.first = first.removeprefix(_BOM)
    return io.TextIOWrapper(raw, encoding="utf-16" if raw.zeros else "latin-1", errors="replace")  # type: ignore[arg-type]


def is_plain(path: Path) -> bool:
    """Return whether numpy can read the lines of a file as `open_lines` does."""
    with path.open("rb") as file:
        beginning = file.read(8)
    is_packed = path.suffix in (".gz", ".bz2", ".xz")  # numpy goes by the name
    return not is_packed and not beginning.startswith((*_PACKED, *_UTF16, _BOM))


def _opened(path: Path) -> tuple[IO[bytes], IO[bytes]]:
    """Return the bytes of a file without its compression, and the file."""
    inner = path.open("rb", buffering=0)
    beginning = inner.read(8)
    inner.seek(0)
    modules = next((names for magic, names in _PACKED.items() if beginning.startswith(magic)), ())
    for name in modules:
        with contextlib.suppress(ImportError):
            return importlib.import_module(name).open(inner, "rb"), inner
    if not modules:
        return inner, inner
    inner.close()
    raise InputError(f"{path} is compressed with zstd; decompress it: unzstd {path.name}")


def head_of(path: Path) -> Head:
    """Return the first lines of a file, without ends, and whether these are all."""
    with path.open("rb") as file:
        start = file.read(HEAD)
    for beginning, reason in _REFUSED.items():
        if re.match(beginning, start) and not start.startswith((*_PACKED, *_UTF16)):
            import shlex  # only for this message

            raise InputError(f"{path} is {reason.replace('{name}', shlex.quote(path.name))}")
    with open_lines(path) as file:
        text = file.read(HEAD)
        more = bool(file.read(1))
    lines = text.splitlines()
    if more and len(lines) > 1:
        lines.pop()  # the last line can be incomplete
    if not text.strip():
        raise InputError(f"{path} is empty; check that the recording has poses")
    return lines, not more
