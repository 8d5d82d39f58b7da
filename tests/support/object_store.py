"""A real S3 server on loopback, behind a wire that counts what it carries."""

from __future__ import annotations

import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.request import Request, urlopen

import pytest
from moto.server import ThreadedMotoServer


class Wire(socketserver.ThreadingTCPServer):
    """Passes on what goes to a server and comes from it.

    Attributes:
        carried: Bytes that came from the server, heads of its answers included.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, server: tuple[str, int]) -> None:
        """Listen on a free port of loopback."""
        super().__init__(("127.0.0.1", 0), _Connection)
        self.server = server
        self.carried = 0
        self.lock = threading.Lock()

    @property
    def url(self) -> str:
        """Where clients find it."""
        return f"http://127.0.0.1:{self.server_address[1]}"


class _Connection(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        wire: Any = self.server
        with socket.create_connection(wire.server) as there:
            threading.Thread(target=self._send, args=(there,), daemon=True).start()
            while piece := _received(there):
                with wire.lock:
                    wire.carried += len(piece)
                self.request.sendall(piece)

    def _send(self, there: socket.socket) -> None:
        while piece := _received(self.request):
            there.sendall(piece)
        there.close()


def _received(connection: socket.socket) -> bytes:
    try:
        return connection.recv(1 << 16)
    except OSError:
        return b""


@contextmanager
def object_store() -> Iterator[Wire]:
    """Start a server without buckets, and the wire to it."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        with Wire(server.get_host_and_port()) as wire:
            # All servers of a process have the same buckets, also those that ended.
            urlopen(
                Request("http://{}:{}/moto-api/reset".format(*wire.server), method="POST")
            ).close()
            threading.Thread(target=wire.serve_forever, daemon=True).start()
            yield wire
            wire.shutdown()
    finally:
        server.stop()


@contextmanager
def bucket(url: str) -> Iterator[Wire]:
    """Make a URL a bucket of a server on loopback, for this process and those it starts."""
    from upath import UPath

    with object_store() as wire, pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", wire.url)
        patch.setenv("AWS_ACCESS_KEY_ID", "nobody")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        store = UPath(url)
        store.fs.mkdir(store.path)
        yield wire
        store.fs.clear_instance_cache()
