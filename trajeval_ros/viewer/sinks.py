"""Destinations of a live picture: a file, a server for viewers, or a viewer."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
from collections.abc import Callable
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError, SettingsError, reason_of
from trajeval_ros.viewer.scene_entities import APPLICATION
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.stream import Sink

_LEAST_ROOM, _LITTLE_ROOM = 2**16, 2**20  # bytes
LOOPBACK = "127.0.0.1"
_ALL_ADDRESSES = ("0.0.0.0", "::")
PORT = 9876
_FILE_FLUSH_S = 20.0
_SERVER_MEMORY = "512MB"
_PROBE_S = 0.3


def open_file(recording: Any, path: Path, blueprint: Any, *, write_footer: bool = True) -> None:
    """Write a recording to a file from now on."""
    rerun, _ = sdk()
    _require_room(path)
    sink = rerun.FileSink(str(path), write_footer=write_footer)
    recording.set_sinks(sink, default_blueprint=blueprint)


def flush_to(path: Path, recording: Any) -> None:
    """Flush a recording to its file."""
    try:
        recording.flush()
    except RuntimeError as error:
        if _room(path) < _LITTLE_ROOM:
            raise _no_space() from error
        raise OSError(str(error)) from error
    _require_room(path)  # on a nearly full disk, flush may drop data without an error


def _require_room(path: Path, least: int = _LEAST_ROOM) -> None:
    """Check that the disk has room for a few chunks, or for a number of bytes."""
    if _room(path) < least:
        raise _no_space()


def _room(path: Path) -> int:
    """Return the free bytes of the disk."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize


def _no_space() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def recording_writer(
    title: str, blueprint: Any, draw: Callable[[Any], object]
) -> Callable[[Path], None]:
    """Return a function that writes a picture to a path, and raises OSError on a full disk."""
    rerun, _ = sdk()

    def write(path: Path) -> None:
        # Without room for a complete recording, its writer can wait without end.
        _require_room(path, _LITTLE_ROOM)
        recording = rerun.RecordingStream(APPLICATION)
        recording.set_log_time_enabled(False)
        open_file(recording, path, blueprint)
        try:
            recording.send_recording_name(title)
            draw(recording)
            flush_to(path, recording)
        finally:
            recording.disconnect()

    return write


class FileTarget:
    """A file (.rrd).

    Every flush writes a chunk per entity, of at least one kilobyte. Therefore the file is flushed
    rarely: a killed process loses the last 20 s of the picture, and a full disk is detected after
    up to 20 s. The file has no footer, because a footer keeps one or two kilobytes per chunk in
    memory until the end, and a node may run for days.
    """

    name, absence = "file", ""
    check_every_s = _FILE_FLUSH_S

    def __init__(self, path: Path, recording_id: str) -> None:
        """Name the file; it is replaced if it exists."""
        self._path, self._id = path, recording_id
        self._whole = 0  # bytes that are known to be on disk

    def open(self, blueprint: Any) -> Any:
        """Return a recording that writes to the file."""
        recording = _recording(self._id, flush_s=60.0 * _FILE_FLUSH_S)
        try:
            self._path.open("ab").close()
            try:
                open_file(recording, self._path, blueprint, write_footer=False)
            except OSError:
                if not self._path.stat().st_size:
                    self._path.unlink()
                raise
        except OSError as error:
            raise InputError(f"{self._path} can't be written: {reason_of(error)}") from error
        return recording

    def check(self, recording: Any) -> bool:
        """Write everything to the file."""
        try:
            flush_to(self._path, recording)
            self._whole = self._path.stat().st_size
        except OSError as error:
            # A partial chunk at the end makes the whole file unreadable, so it is cut off. Rerun
            # is disconnected first, because it would write its remaining data after the cut.
            recording.disconnect()
            with contextlib.suppress(OSError):
                if self._whole:
                    os.truncate(self._path, self._whole)
                else:
                    self._path.unlink()
            raise InputError(f"{self._path} can't be written: {reason_of(error)}") from error
        return True

    def close(self, recording: Any) -> None:
        """End the file."""
        self.check(recording)
        recording.disconnect()


class ServerTarget:
    """A server, for viewers that connect at any time."""

    name, absence = "server", ""
    check_every_s = 1.0

    def __init__(self, address: str, port: int, recording_id: str) -> None:
        """Name the address of this machine to listen at, and the port."""
        host = socket.gethostname() if address in _ALL_ADDRESSES else address
        self.url = f"rerun+http://{f'[{host}]' if ':' in host else host}:{port}/proxy"
        self._address, self._port, self._id = address, port, recording_id

    def open(self, blueprint: Any) -> Any:
        """Return a recording that the server holds."""
        rerun, _ = sdk()
        family = socket.AF_INET6 if ":" in self._address else socket.AF_INET
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((self._address, self._port))
            except OSError as error:
                where = "" if self._address == LOOPBACK else f" of {self._address}"
                raise InputError(
                    f"Rerun can't use port {self._port}{where}: {reason_of(error)}; choose "
                    f"another port, as in rerun:=serve:{self._port + 1}"
                ) from error
        recording = _recording(self._id, flush_s=0.5)
        server = rerun.GrpcServerSink(
            self._address, self._port, server_memory_limit=_SERVER_MEMORY
        )
        recording.set_sinks(server, default_blueprint=blueprint)
        return recording

    def check(self, recording: Any) -> bool:
        """Return True: the server does not depend on its viewers."""
        del recording
        return True

    def close(self, recording: Any) -> None:
        """End the server."""
        recording.disconnect()


class ViewerTarget:
    """A viewer that listens at an address, such as the program `rerun`."""

    name = "viewer"
    check_every_s = 2.0

    def __init__(self, url: str, recording_id: str) -> None:
        """Name the viewer."""
        match = re.fullmatch(r"rerun\+https?://(\[[^\]]+\]|[^:/\s]+):(\d{1,5})/proxy", url)
        if match is None:
            raise SettingsError(
                f"{url!r} is not the URL of a viewer; write it as in "
                f"connect:rerun+http://{LOOPBACK}:{PORT}/proxy"
            )
        self._url, self._id = url, recording_id
        self.absence = f"no viewer answers at {url}; one that starts later gets the whole run"
        self._address = match[1].strip("[]"), int(match[2])

    def open(self, blueprint: Any) -> Any | None:
        """Return a recording that the viewer shows; None while no viewer listens."""
        # A connection to a closed port takes five seconds and may hang later.
        if not self._is_there():
            return None
        recording = _recording(self._id, flush_s=0.5)
        recording.connect_grpc(self._url, default_blueprint=blueprint)
        return recording

    def check(self, recording: Any) -> bool:
        """Return whether the viewer listens; a lost connection is never restored."""
        del recording
        return self._is_there()

    def close(self, recording: Any) -> None:
        """Disconnect; flushing to a viewer that does not read would hang."""
        recording.disconnect()

    def _is_there(self) -> bool:
        try:
            socket.create_connection(self._address, _PROBE_S).close()
        except OSError:
            return False
        return True


def sinks_for(value: str, file: Path, recording_id: str) -> list[Sink]:
    """Return the sinks for a value of the parameter `rerun`."""
    kind, _, where = value.partition(":")
    if value == "none":
        return []
    kept = FileTarget(file, recording_id)
    if value == "file":
        return [kept]
    if kind == "serve" and (served := _served(where)) is not None:
        return [kept, ServerTarget(*served, recording_id)]
    if kind == "connect":
        return [kept, ViewerTarget(where, recording_id)]
    raise SettingsError(
        "rerun must be none, file, serve, serve:PORT, serve:ADDRESS:PORT or "
        f"connect:rerun+http://{LOOPBACK}:{PORT}/proxy, not {value!r}"
    )


def _served(where: str) -> tuple[str, int] | None:
    """Return address and port of `PORT` or `ADDRESS:PORT`; None for other texts."""
    address, _, port = where.rpartition(":")
    try:
        if address:
            address = str(ip_address(address.removeprefix("[").removesuffix("]")))
        number = int(port or PORT)
    except ValueError:
        return None
    return (address or LOOPBACK, number) if 0 < number < 65536 else None


def _recording(recording_id: str, flush_s: float) -> Any:
    rerun, _ = sdk()
    recording = rerun.RecordingStream(
        APPLICATION,
        recording_id=recording_id,
        batcher_config=rerun.ChunkBatcherConfig(flush_tick=flush_s),
    )
    recording.set_log_time_enabled(False)
    return recording
