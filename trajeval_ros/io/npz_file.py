"""Writing and reading of arrays in npz archives.

An archive is untrusted input. Only the requested arrays are read, and an array with an
implausible compression ratio is refused.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.compression import LARGEST_RATIO, most_of

_LARGEST = 1 << 29  # bytes of an array that are accepted at any compression ratio


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compressed: bool = True) -> None:
    """Write an archive array by array, without a copy of it in memory.

    The file is closed here: zipfile would close it on a full disk when it is garbage collected,
    and raise again.
    """
    save = np.savez_compressed if compressed else np.savez
    with path.open("wb") as file:
        save(file, **arrays)


def read_arrays(path: Path, names: Collection[str]) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive that have one of the names; other arrays are not read."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = {item.filename.removesuffix(".npy"): item for item in archive.infolist()}
            return {
                name: _array(archive, members[name], f"{path}: {name}")
                for name in names
                if name in members
            }
    except (InputError, FileNotFoundError, PermissionError):
        raise
    except MemoryError:
        raise InputError(f"{path} does not fit into memory") from None
    except Exception as error:  # damage raises many types of exceptions
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
        file.read()  # zipfile verifies the checksum at the end of the member
    return array
