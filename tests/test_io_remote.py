"""Bags in object storage: a real server on loopback, and the bytes that it was asked for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from test_io_damage import COUNT, mcap_file, rows_of

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import Bag
from trajeval_ros.io.sources import parse_source, read_trajectory

upath = pytest.importorskip("upath", reason="universal_pathlib is missing")
IMAGE = bytes(100_000)


def among_images(path: Path) -> Path:
    """Write poses among images that are 60 times as large."""
    from test_io_damage import payloads

    def images(writer: Any) -> None:
        channel = writer.register_channel("/image", "x", 0)
        add = writer.add_message

        def with_image(topic: int, log_time: int, payload: bytes, published: int) -> None:
            add(topic, log_time, payload, published)
            if (log_time // 10**9) % 4 == 0:
                add(channel, log_time, IMAGE, published)

        writer.add_message = with_image

    return mcap_file(path, messages=payloads(), others=images, chunk_size=1 << 20)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return the URL of a bucket."""
    server = pytest.importorskip("moto.server", reason="moto's server is missing")
    pytest.importorskip("s3fs", reason="s3fs is missing")
    running = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    given = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "nobody",
        "AWS_SECRET_ACCESS_KEY": "nothing",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    before = dict(os.environ)
    os.environ.update(given)
    try:
        bucket = upath.UPath("s3://flights")
        bucket.fs.mkdir("flights")
        folder = tmp_path_factory.mktemp("bags")
        content = among_images(folder / "x.mcap").read_bytes()
        (bucket / "x.mcap").write_bytes(content)
        (bucket / "cut.mcap").write_bytes(content[: len(content) // 2])
        zstd = mcap_file(folder / "z.mcap", compression=CompressionType.ZSTD)
        (bucket / "zstd.mcap").write_bytes(zstd.read_bytes())
        (bucket / "text.txt").write_bytes(b"1 2 3 4 0 0 0 1\n")
        yield "s3://flights"
    finally:
        os.environ.clear()
        os.environ.update(before)
        running.stop()


def test_only_ranges_are_fetched(store: str) -> None:
    source = f"{store}/x.mcap:/pose"
    assert rows_of(read_trajectory(source)) == list(range(COUNT))
    parts = parse_source(source)
    with Bag(parts.path) as bag:
        payloads = [payload for _, _, payload in bag.messages(bag.find(parts.topic))]
        (container,) = bag._containers
        file: Any = container
        assert len(payloads) == COUNT
        assert file._source.fetched < 0.05 * file._source.size


def test_what_is_compressed_or_cut_is_read_as_well(store: str) -> None:
    assert rows_of(read_trajectory(f"{store}/zstd.mcap")) == list(range(COUNT))
    cut = read_trajectory(f"{store}/cut.mcap:/pose")
    assert rows_of(cut) == list(range(len(cut)))
    assert cut.damage


def test_what_is_not_there_is_a_mistake(store: str) -> None:
    with pytest.raises(InputError, match="is no bag"):
        read_trajectory(f"{store}/text.txt:/pose")
    with pytest.raises(InputError, match="does not exist"):
        read_trajectory(f"{store}/y.mcap:/pose")


@pytest.mark.parametrize("scheme", ["memory", "file"])
def test_other_stores(scheme: str, tmp_path: Path) -> None:
    content = among_images(tmp_path / "x.mcap").read_bytes()
    url = f"{scheme}://{tmp_path}/y.mcap"
    path = upath.UPath(url)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    read = read_trajectory(f"{url}:/pose")
    np.testing.assert_array_equal(read.positions[:, 0], np.arange(COUNT))
