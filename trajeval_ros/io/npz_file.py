"""Arrays of an npz archive, written at once and read one by one.

An archive that is read may be a stranger's: only what is asked for is looked at, and no bombs.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Collection, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.compression import LARGEST_RATIO, most_of

_LARGEST = 1 << 29  # bytes that an array may become, however well it is compressed


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compressed: bool = True) -> None:
    """Write an archive at once.

    On a full disk, zipfile leaves an open archive behind, which complains when it is collected.

    Raises:
        OSError: The file can't be written.
    """
    archive = BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(archive, **arrays)
    path.write_bytes(archive.getbuffer())


def read_arrays(path: Path, names: Collection[str]) -> dict[str, NDArray[Any]]:
    """Return those arrays of an archive that have one of the names; others aren't looked at.

    Raises:
        InputError: The archive can't be read, or one of the arrays isn't what its head says, holds
            Python objects, or becomes more than any real one does.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
            return {
                name: _array(archive, members[name], f"{path}: {name}")
                for name in names
                if name in members
            }
    except (InputError, FileNotFoundError, PermissionError):
        raise
    except MemoryError:
        raise InputError(f"{path} does not fit into memory") from None
    except Exception as error:  # of a dozen kinds: what damage raises is chance
        raise InputError(f"{path} is not an npz archive of plain arrays, or is damaged") from error


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, what: str) -> NDArray[Any]:
    with archive.open(member) as file:
        read_head = (
            np.lib.format.read_array_header_1_0
            if np.lib.format.read_magic(file) == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = read_head(file)
        size, head = math.prod(shape) * kind.itemsize, file.tell()
    if kind.hasobject or head + size != member.file_size:
        raise InputError(f"{what} is not a plain array, or its size is wrong")
    if member.file_size > most_of(member.compress_size, _LARGEST):
        raise InputError(
            f"{what} has a compression ratio above {LARGEST_RATIO}; if you trust the file, save "
            "it uncompressed with numpy.savez"
        )
    with archive.open(member) as file:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
        file.read()  # its end, where the checksum is looked at
    return array
