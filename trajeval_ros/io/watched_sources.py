"""Reading of the SOURCEs of a watchdog: estimate, IMU, second estimates, map corrections."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.io.sources import Advance, parse_source, read_many
from trajeval_ros.watchdog.recording import WatchedRun


def read_watched(
    estimate: str,
    imu: str | None = None,
    partners: Mapping[str, str] = MappingProxyType({}),
    *,
    corrections: str | None = None,
    advance: Advance | None = None,
) -> WatchedRun:
    """Read the SOURCEs of a watchdog run.

    `partners`: second estimates, by name (`pair_sources`). `corrections`: transforms from the map
    to the estimate's frame.
    """
    asked = (estimate, *partners.values(), corrections)
    poses = [item for item in asked if item is not None]
    # Only those of an estimate with an IMU are tested.
    covariances = [imu is not None and pose == estimate for pose in poses]
    trajectories = read_many(poses, advance=advance, covariances=covariances)
    read = dict(zip(poses, trajectories, strict=True))
    return WatchedRun(
        read[estimate],
        None if imu is None else imu_of(imu),
        {name: read[partner] for name, partner in partners.items()},
        None if corrections is None else read[corrections],
    )


def imu_of(source: str) -> InertialReadings:
    """Read an IMU topic of a bag, or a table with the columns of EuRoC's mav0/imu0/data.csv.

    Raises:
        InputError: The source is neither.
    """
    parts = parse_source(source)
    if not parts.is_bag and not parts.is_log and not parts.is_pipe:
        from trajeval_ros.io.text.sensor_table import IMU, read_samples

        stamps, values = read_samples(parts.path, IMU)
        return InertialReadings(stamps, values[:, :3].copy(), values[:, 3:].copy(), source=source)
    if not parts.is_bag or not parts.topic or parts.frames is not None:
        raise InputError(
            f"{source} is not a topic of a bag; give an IMU topic, as in run.mcap:/imu, or a "
            "table of time, angular velocity and acceleration, as in mav0/imu0/data.csv"
        )
    from trajeval_ros.io.bags.rate_messages import read_rates

    return read_rates(parts.path, parts.topic)
