"""Hashes of this package's sources, because numbers depend on them.

During development, many states of the sources have the same version. A hash identifies one.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent
# All modules that `batch/worker.py` imports, directly or indirectly.
_OF_NUMBERS = (
    "exceptions.py",
    "geometry",
    "continuous_time",
    "metrics",
    "calibration",
    "consistency",
    "likelihood",
    "diagnosis",
    "watchdog",
    "pipeline",
    "formatting",
    "io",
    "report/line_thinning.py",
    "batch/plan.py",
    "batch/records.py",
    "batch/source_hash.py",
    "batch/worker.py",
)


def sources_of_numbers() -> list[Path]:
    """Return the sources that the numbers of a run depend on."""
    places = [_PACKAGE / of_number for of_number in _OF_NUMBERS]
    return [file for place in places for file in ([place] if place.is_file() else _below(place))]


@functools.cache
def hash_of_numbers() -> str:
    """Return the sha256 of the sources that the numbers of a run depend on."""
    return _hash(sources_of_numbers())


@functools.cache
def hash_of_package() -> str:
    """Return the sha256 of all sources, those that draw and the templates included."""
    return _hash(_below(_PACKAGE))


def _below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.suffix in (".py", ".j2")]


def _hash(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(f"{file.relative_to(_PACKAGE).as_posix()}\n".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
