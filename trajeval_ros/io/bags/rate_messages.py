"""Angular velocities from messages: of an IMU, and of the twist of an odometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.arrays import Booleans
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.cdr import CdrPlan, plan_with
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.containers import Topic, TopicReading
from trajeval_ros.io.bags.message_definitions import Fields, recorded_fields
from trajeval_ros.io.bags.pose_messages import stamps_of

IMU_TYPE = "sensor_msgs/msg/Imu"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_FRAME = "header.frame_id"
# Angular velocity, and acceleration where there is one.
_FIELDS = {
    IMU_TYPE: ("angular_velocity", "linear_acceleration"),
    ODOMETRY_TYPE: ("twist.twist.angular",),
}


def decode_rates(payloads: Sequence[bytes | memoryview], message_type: str) -> InertialReadings:
    """Return the readings of ROS 2 messages, by the standard definition of their type.

    `payloads`: in CDR. Messages that can't be decoded or are not finite are left out and counted.
    `message_type`: `sensor_msgs/msg/Imu` or `nav_msgs/msg/Odometry`.
    """
    columns = _plan(message_type).decode(payloads)
    return _readings(columns, message_type, len(payloads))


def read_rates(path: Path, name: str) -> InertialReadings:
    """Read a topic of a bag, in order of the log times of its messages."""
    with Bag(path) as bag:
        topic = _topic(bag, name)
        reading = TopicReading(topic)
        plans = {
            (id(each.owner), each.id): _plan_of(
                recorded_fields(each), topic.type, is_ros1=each.encoding == "ros1"
            )
            for each in topic.connections
        }
        parts, times = [], []
        for _, key, block in bag.blocks([reading]):
            columns = plans[key].decode_at(block.buffer, block.begins, block.sizes)
            parts.append(_readings(columns, topic.type, len(block)))
            times.append(block.log_times[columns.rows][_usable(columns, topic.type)])
        remarks = bag.remarks([reading])
    if not sum(map(len, parts)):
        raise InputError(f"{path}:{name} has no usable {topic.type}")
    order = np.argsort(np.concatenate(times), kind="stable")
    accelerations = [each.accelerations for each in parts if each.accelerations is not None]
    return InertialReadings(
        np.concatenate([each.stamps for each in parts])[order],
        np.concatenate([each.rates for each in parts])[order],
        np.concatenate(accelerations)[order] if accelerations else None,
        parts[0].frame,
        f"{path}:{name}",
        sum(each.undecodable for each in parts),
        tuple(each.text for each in remarks if each.level is Level.ERROR),
    )


def _topic(bag: Bag, name: str) -> Topic:
    """Return the topic of that name that holds angular velocities."""
    found = bag.find(name)
    for topic in found:
        if topic.type in _FIELDS:
            return topic
    others = [each.name for each in bag.topics if each.type == IMU_TYPE]
    listed = ", and no other topic has them"
    if others:
        listed = f"; IMU messages are on {', '.join(others)}"
    raise InputError(f"{bag.path}: {name} has type {found[0].type}, not {IMU_TYPE}{listed}")


@cache
def _plan(message_type: str) -> CdrPlan:
    return _plan_of(None, message_type, is_ros1=False)


def _plan_of(fields: Fields | None, message_type: str, *, is_ros1: bool) -> CdrPlan:
    wanted = [*_STAMP, _FRAME, *_FIELDS[message_type]]
    return plan_with(fields, message_type, wanted, is_ros1=is_ros1)


def _readings(columns: Columns, message_type: str, count: int) -> InertialReadings:
    """Return decoded columns without rows that are not finite."""
    good = _usable(columns, message_type)
    vectors = [np.asarray(columns.numbers[each], float) for each in _FIELDS[message_type]]
    names = columns.texts[_FRAME].names
    return InertialReadings(
        stamps_of(columns)[good],
        vectors[0][good],
        vectors[1][good] if len(vectors) > 1 else None,
        names[0].lstrip("/") if names else "",
        undecodable=count - int(np.count_nonzero(good)),
    )


def _usable(columns: Columns, message_type: str) -> Booleans:
    vectors = [columns.numbers[each] for each in _FIELDS[message_type]]
    good: Booleans = np.logical_and.reduce(
        [(np.abs(each) <= LARGEST).all(axis=1) for each in vectors]
    )
    return good
