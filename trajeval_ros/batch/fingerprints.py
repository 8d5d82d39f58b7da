"""Hashes of the bytes of a SOURCE, to detect changes."""

from __future__ import annotations

import contextlib
import hashlib
import time
from pathlib import Path
from typing import Any

from trajeval_ros.batch.patterns import is_url, split_topic
from trajeval_ros.batch.remote_files import open_store
from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.io.json_file import json_text, mapping_in_file
from trajeval_ros.io.sources import parse_source
from trajeval_ros.io.text.numpy_files import files_of_times
from trajeval_ros.io.writing import write_text

_NANOSECONDS = 1_000_000_000
# A file that changed less than this before it was hashed may change again with the same time.
_SETTLED_NS = 2 * _NANOSECONDS
# Hashing bags takes long: after a kill, it is not repeated.
_SAVED_EVERY_S = 5.0


class Fingerprints:
    """sha256 of inputs, stored with size and time of change, as in the index of git."""

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        self._known: dict[str, list[Any]] = {}
        self._of_source: dict[str, str] = {}
        self._changed = False
        self._saved_at = time.monotonic()
        with contextlib.suppress(OSError):  # without stored hashes, all files are read
            self._known = mapping_in_file(memory) or {}

    def of(self, source: str) -> str:
        """Return the sha256 of the bytes and the topic of a SOURCE."""
        if source not in self._of_source:
            self._of_source[source] = self._fingerprint(source)
            if time.monotonic() > self._saved_at + _SAVED_EVERY_S:
                self.save()
        return self._of_source[source]

    def save(self) -> None:
        """Store the hashes for the next start."""
        if self._changed:
            write_text(self._memory, json_text(self._known, indent=0))
            self._changed = False
        self._saved_at = time.monotonic()

    def _fingerprint(self, source: str) -> str:
        path, topic = split_topic(source)
        digest = hashlib.sha256(topic.encode())
        if is_url(path):
            digest.update(_remote_state(path).encode())
            return digest.hexdigest()
        try:
            for file in self._files_of(source):
                digest.update(self._file(file).encode())
        except OSError as error:
            raise InputError(
                f"{error.filename or source} can't be read: {reason_of(error)}"
            ) from error
        return digest.hexdigest()

    def _files_of(self, source: str) -> list[Path]:
        """Return the files of this machine that a SOURCE reads."""
        local = Path(source)
        # The format of a file that was hashed before is not detected again.
        if str(local.absolute()) not in self._known or not local.is_file():
            local = parse_source(source).path
            if local.is_dir():
                files = [path for path in sorted(local.rglob("*")) if path.is_file()]
                return files or [local]
        log = local.with_name(f"{local.name}-wal")  # of an sqlite bag
        return [local, *files_of_times(local), *([log] if log.is_file() else [])]

    def _file(self, path: Path) -> str:
        name, state = str(path.absolute()), path.stat()
        changed = max(state.st_mtime_ns, state.st_ctime_ns)  # `cp -p` keeps mtime, not ctime
        now = [state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino]
        known = self._known.get(name)
        if known and known[:-1] == now:
            return str(known[-1])
        digest = hash_of_file(path)
        if time.time_ns() - changed > _SETTLED_NS:
            self._known[name] = [*now, digest]
            self._changed = True
        return digest


def hash_of_file(path: Path) -> str:
    """Return the sha256 of a file of any size."""
    with path.open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _remote_state(url: str) -> str:
    """Return the tag of a remote file, or its size and time, which change with its content."""
    with open_store(url) as (files, path):
        return str(files.ukey(path))
