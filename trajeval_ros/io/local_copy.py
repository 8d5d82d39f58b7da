"""Local copies of text from pipes and remote stores; readers read a text file several times."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.byte_source import source_of

_AT_ONCE = 1 << 23  # bytes per request to a store


@contextmanager
def local_file(path: Any) -> Iterator[Path]:
    """Yield a local file as it is, or a temporary copy of a pipe or of a remote object.

    Messages about the copy name the original.

    Args:
        path: A local path, or a path of universal_pathlib.

    Raises:
        OSError: The original can't be read.
    """
    if isinstance(path, Path) and path.is_file():
        yield path
        return
    from trajeval_ros.io.temporary import temporary_folder

    with temporary_folder("copy") as folder:
        copy = folder / path.name
        with copy.open("wb") as writing:
            if isinstance(path, Path):
                with path.open("rb") as reading:
                    shutil.copyfileobj(reading, writing)
            else:
                _download(path, writing)
        try:
            yield copy
        except InputError as error:
            raise InputError(str(error).replace(str(copy), str(path))) from error


def _download(path: Any, writing: BinaryIO) -> None:
    source = source_of(path)
    for offset in range(0, source.size, _AT_ONCE):
        writing.write(source.read(offset, _AT_ONCE))
