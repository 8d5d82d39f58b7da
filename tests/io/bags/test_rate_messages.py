"""Readings of IMUs: read as written, and the unusable ones counted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from strategies import make_groundtruth

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.io.bags.encode_messages import encode_imu, encode_stamped
from trajeval_ros.io.bags.rate_messages import decode_rates, read_rates
from trajeval_ros.io.bags.write_bag import ODOMETRY, write_bag
from trajeval_ros.io.watched_sources import imu_of, read_watched

SECOND = 10**9


def readings(count: int = 9, first_s: int = 5) -> InertialReadings:
    rng = np.random.default_rng(count)
    stamps = first_s * SECOND + 10_000_000 * np.arange(count)
    return InertialReadings(
        stamps, rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), "imu"
    )


def payloads(source: InertialReadings) -> list[bytes]:
    assert source.accelerations is not None
    rows = encode_imu(source.stamps, source.rates, source.accelerations, f"/{source.frame}")
    return [row.tobytes() for row in rows]


def assert_same(outcome: InertialReadings, expected: InertialReadings, rows: Any = ...) -> None:
    np.testing.assert_array_equal(outcome.stamps, expected.stamps[rows])
    np.testing.assert_array_equal(outcome.rates, expected.rates[rows])
    assert outcome.accelerations is not None
    assert expected.accelerations is not None
    np.testing.assert_array_equal(outcome.accelerations, expected.accelerations[rows])


def test_messages_of_an_imu_are_decoded() -> None:
    source = readings()
    result = decode_rates(payloads(source))
    assert_same(result, source)
    assert (result.frame, result.undecodable) == ("imu", 0)
    nothing = decode_rates([])
    assert (len(nothing), nothing.frame) == (0, "")


@pytest.mark.parametrize("part", ["rates", "accelerations"])
@pytest.mark.parametrize(
    ("value", "is_kept"),
    [(LARGEST, True), (-LARGEST, True), (1.001 * LARGEST, False), (-np.inf, False),
     (np.nan, False)],
)  # fmt: skip
def test_readings_that_are_no_numbers_are_counted(
    part: str, value: float, *, is_kept: bool
) -> None:
    source = readings()
    getattr(source, part)[4, 2] = value
    result = decode_rates([*payloads(source), b"\0\1\0\0short"])
    rows = np.arange(9) if is_kept else np.delete(np.arange(9), 4)
    assert_same(result, source, rows)
    assert result.undecodable == 1 + (not is_kept)


def test_messages_of_another_type_are_counted() -> None:
    vectors = encode_stamped(np.arange(4), np.zeros((4, 3)), "x")
    assert decode_rates([vector.tobytes() for vector in vectors]).undecodable == 4


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rates") / "run"
    truth = make_groundtruth(0, 20)
    write_bag(
        path,
        {"/vio": (truth, ODOMETRY), "/other": (truth[:10], ODOMETRY)},
        inertial={"/imu": readings(), "/second": readings(5, 100)},
    )
    return path


def test_a_topic_of_a_bag_is_read_as_written(bag: Path) -> None:
    result = read_rates(bag, "/imu")
    assert_same(result, readings())
    assert (result.frame, result.source, result.undecodable) == ("imu", f"{bag}:/imu", 0)
    assert result.damage == ()


def test_readings_are_in_the_order_of_their_recording(tmp_path: Path) -> None:
    """Two files with the same topic, the later one first; timestamps are not sorted."""
    folder = tmp_path / "both"
    folder.mkdir()
    late, early = readings(6, 50), readings(4, 7)
    late.stamps[[1, 2]] = late.stamps[[2, 1]]
    for name, source in (("a", late), ("b", early)):
        write_bag(tmp_path / name, {}, inertial={"/imu": source})
        (tmp_path / name / f"{name}.mcap").rename(folder / f"{name}.mcap")
    result = read_rates(folder, "/imu")
    assert result.stamps.tolist() == [*early.stamps.tolist(), *late.stamps.tolist()]
    np.testing.assert_array_equal(result.rates, np.concatenate([early.rates, late.rates]))
    assert result.accelerations is not None
    assert early.accelerations is not None
    np.testing.assert_array_equal(result.accelerations[:4], early.accelerations)


def test_what_is_no_imu_is_refused(bag: Path, tmp_path: Path) -> None:
    assert_same(imu_of(f"{bag}:/imu"), readings())
    with pytest.raises(InputError, match="/vio has type nav_msgs/msg/Odometry, not"):
        imu_of(f"{bag}:/vio")
    with pytest.raises(InputError, match="is not a topic of a bag"):
        imu_of(str(bag))
    (tmp_path / "x.txt").write_text("1 2 3 4\n2 3 4 5\n")
    with pytest.raises(InputError, match="use the columns t wx wy wz ax ay az"):
        imu_of(str(tmp_path / "x.txt"))
    with pytest.raises(InputError, match="has no topic /none"):
        imu_of(f"{bag}:/none")


def test_a_topic_of_another_type_names_those_of_imus(tmp_path: Path) -> None:
    truth = make_groundtruth(0, 20)
    pose = "geometry_msgs/msg/PoseStamped"
    write_bag(tmp_path / "a", {"/pose": (truth, pose)}, inertial={"/imu": readings()})
    with pytest.raises(InputError, match=r"/pose has type .*; IMU messages are on /imu$"):
        read_rates(tmp_path / "a", "/pose")
    write_bag(tmp_path / "b", {"/pose": (truth, pose)})
    with pytest.raises(InputError, match="no other topic has them"):
        read_rates(tmp_path / "b", "/pose")
    lost = readings()
    lost.rates[:] = np.nan
    write_bag(tmp_path / "c", {}, inertial={"/imu": lost})
    with pytest.raises(InputError, match=r"c:/imu has no usable sensor_msgs/msg/Imu"):
        read_rates(tmp_path / "c", "/imu")


def test_a_watch_reads_covariances_only_of_an_estimate_with_an_imu(bag: Path) -> None:
    estimate, partner = f"{bag}:/vio", f"{bag}:/other"
    alone = read_watched(estimate, None, {"slam": partner}, corrections=partner)
    assert len(alone.estimate) == 20
    assert alone.imu is None
    assert {name: len(item) for name, item in alone.partners.items()} == {"slam": 10}
    assert alone.corrections is not None
    assert len(alone.corrections) == 10
    with_imu = read_watched(estimate, f"{bag}:/imu")
    assert with_imu.imu is not None
    assert_same(with_imu.imu, readings())
    assert with_imu.corrections is None
    assert not with_imu.partners
