"""What all tests share: recordings and reference numbers beside the repository, and settings."""

from __future__ import annotations

import functools
import json
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from trajeval_ros.cli.app import main
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory

HERE = Path(__file__).resolve().parent
# For `from strategies import ...` under pytest's importlib mode.
sys.path.insert(0, str(HERE / "support"))
SHARED = HERE.parents[1] / "shared"

# What a shell runs in the background ignores Ctrl-C, and so would every process that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# So does what nohup runs with a lost terminal. A handler is not inherited; being ignored is.
if os.name == "posix" and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

_COMMON: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("repeatable", derandomize=True, max_examples=25, **_COMMON)
settings.register_profile("search", max_examples=500, print_blob=True, **_COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def _shared_folder(name: str) -> Path:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"../shared/{name} is not beside the repository")
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real recordings, which are not part of the repository."""
    return _shared_folder("data")


@pytest.fixture(scope="session")
def reference() -> Callable[[str], Any]:
    """Return a reader of reference numbers: `reference("evo")` is evo.json."""
    folder = _shared_folder("reference")

    @functools.cache
    def read(name: str) -> Any:
        return json.loads((folder / f"{name}.json").read_text())

    return read


@pytest.fixture(scope="session")
def recording(shared_data: Path) -> Callable[[str], Trajectory]:
    """Return a reader of recordings by their path below the data folder, each read once."""

    @functools.cache
    def read(name: str) -> Trajectory:
        return read_trajectory(str(shared_data / name))

    return read


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let evaluations draw no figures, which take most of the time of small runs."""
    monkeypatch.setattr("trajeval_ros.report.figures.outcome_drawings", lambda _: {})


@pytest.fixture(scope="session")
def kept_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of runs of which outputs are kept."""
    from kept_runs import write_kept_runs

    folder = tmp_path_factory.mktemp("runs")
    write_kept_runs(folder)
    return folder


@pytest.fixture(scope="session")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What keeps the traffic on this machine, and apart from others and from other workers."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", 60 + os.getpid() % 40))
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    return {
        **os.environ,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(domain + int(worker)),
        "ROS_HOME": str(tmp_path_factory.mktemp("ros_home")),
        "PYTHONPATH": str(HERE.parent),
    }


@pytest.fixture
def port() -> Iterator[int]:
    """A port of loopback for Rerun's server, at which nobody listens yet.

    It stays bound, so that no other process is given it before the server listens; Rerun's servers
    may listen nevertheless, since they set SO_REUSEADDR, too.
    """
    with socket.socket() as held:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        yield int(held.getsockname()[1])


@pytest.fixture(scope="session")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the same flight in both storage formats of rosbag2."""
    folder = tmp_path_factory.mktemp("bags")
    for storage in ("mcap", "sqlite3"):
        bag = str(folder / storage)
        assert main(["simulate", bag, "--duration", "20", "--storage", storage]) == 0
    return folder


@pytest.fixture(scope="session")
def tracks_flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the feature tracks of a flight; tests do not change it."""
    from tracks_folders import write_tracks_folder

    return write_tracks_folder(tmp_path_factory.mktemp("tracks") / "flight")


@pytest.fixture(scope="module")
def peer(environment: dict[str, str]) -> Iterator[Any]:
    """A ROS node in the test's own process."""
    pytest.importorskip("rclpy", reason="rclpy is missing; `make test-ros` has it")
    from ros_processes import Peer

    peer = Peer(environment)
    yield peer
    peer.close()
