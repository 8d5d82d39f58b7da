"""Reading of the SOURCEs of a watchdog: estimate, IMU, second estimates, map corrections."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import Advance, parse_source, read_many
from trajeval_ros.watchdog.recording import WatchedRun


def read_watched(
    estimate: str,
    imu: str | None = None,
    partners: Mapping[str, str] = MappingProxyType({}),
    groundtruth: str | None = None,
    *,
    corrections: str | None = None,
    advance: Advance | None = None,
) -> tuple[WatchedRun, Trajectory | None]:
    """Read the sources of a watchdog run, and the groundtruth if given.

    Args:
        estimate: SOURCE of the estimate. For odometry in a bag, the angular rates are read, too.
        imu: SOURCE of IMU messages in a bag.
        partners: SOURCEs of second estimates, by name (`pair_sources`).
        groundtruth: SOURCE of the groundtruth.
        corrections: SOURCE of transforms from the map to the estimate's frame.
        advance: Progress callback, called with the amount done and the total.

    Returns:
        The run, and the groundtruth or None.

    Raises:
        InputError: A source can't be read, or `imu` is not an IMU topic of a bag.
    """
    asked = (estimate, *partners.values(), corrections, groundtruth)
    poses = [each for each in asked if each is not None]
    read = dict(zip(poses, read_many(poses, advance=advance, covariances=False), strict=True))
    run = WatchedRun(
        read[estimate],
        _twist_of(estimate),
        None if imu is None else _imu_of(imu),
        {name: read[each] for name, each in partners.items()},
        None if corrections is None else read[corrections],
    )
    return run, None if groundtruth is None else read[groundtruth]


def _twist_of(estimate: str) -> InertialReadings | None:
    """Return the angular rates of odometry in a bag; None for other sources."""
    parts = parse_source(estimate)
    if not parts.is_bag or parts.frames is not None:
        return None
    from trajeval_ros.io.bags.bag import Bag
    from trajeval_ros.io.bags.rate_messages import ODOMETRY_TYPE, read_rates

    with Bag(parts.path, None) as bag:
        names = [
            topic.name
            for topic in bag.topics
            if topic.type == ODOMETRY_TYPE and parts.topic in ("", topic.name)
        ]
    return read_rates(parts.path, names[0]) if len(names) == 1 else None


def _imu_of(source: str) -> InertialReadings:
    parts = parse_source(source)
    if not parts.is_bag or not parts.topic or parts.frames is not None:
        raise InputError(
            f"{source} is not a topic of a bag; give an IMU topic, as in run.mcap:/imu"
        )
    from trajeval_ros.io.bags.rate_messages import read_rates

    readings = read_rates(parts.path, parts.topic)
    if readings.accelerations is None:
        raise InputError(
            f"{source} is odometry, not an IMU; give a topic of type sensor_msgs/msg/Imu"
        )
    return readings
