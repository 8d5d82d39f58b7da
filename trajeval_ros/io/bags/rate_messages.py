"""Angular velocities and accelerations from the messages of an IMU."""

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
_FRAME = "header.frame_id"
_VECTORS = "angular_velocity", "linear_acceleration"
_FIELDS = ["header.stamp.sec", "header.stamp.nanosec", _FRAME, *_VECTORS]


def decode_rates(payloads: Sequence[bytes | memoryview]) -> InertialReadings:
    """Return the readings of `sensor_msgs/msg/Imu` of ROS 2, by the standard definition.

    `payloads`: in CDR. Messages that can't be decoded or are not finite are left out and counted.
    """
    return _readings(_plan().decode(payloads), len(payloads))


def read_rates(path: Path, name: str) -> InertialReadings:
    """Read a topic of a bag, in order of the log times of its messages."""
    with Bag(path) as bag:
        topic = _topic(bag, name)
        reading = TopicReading(topic)
        plans = {
            (id(connection.owner), connection.id): _plan_of(
                recorded_fields(connection), is_ros1=connection.encoding == "ros1"
            )
            for connection in topic.connections
        }
        parts, accelerations, times = [], [], []
        for _, key, block in bag.blocks([reading]):
            columns = plans[key].decode_at(block.buffer, block.begins, block.sizes)
            parts.append(_readings(columns, len(block)))
            accelerations.append(parts[-1].accelerations)
            times.append(block.log_times[columns.rows][_usable(columns)])
        remarks = bag.remarks([reading])
    if not sum(map(len, parts)):
        raise InputError(f"{path}:{name} has no usable {topic.type}")
    order = np.argsort(np.concatenate(times), kind="stable")
    return InertialReadings(
        np.concatenate([part.stamps for part in parts])[order],
        np.concatenate([part.rates for part in parts])[order],
        np.concatenate(
            [acceleration for acceleration in accelerations if acceleration is not None]
        )[order],
        parts[0].frame,
        f"{path}:{name}",
        sum(part.undecodable for part in parts),
        tuple(remark.text for remark in remarks if remark.level is Level.ERROR),
    )


def _topic(bag: Bag, name: str) -> Topic:
    """Return the topic of that name that an IMU publishes."""
    matches = bag.find(name)
    for topic in matches:
        if topic.type == IMU_TYPE:
            return topic
    others = [item.name for item in bag.topics if item.type == IMU_TYPE]
    listed = f"IMU messages are on {', '.join(others)}" if others else "no other topic has them"
    raise InputError(f"{bag.path}: {name} has type {matches[0].type}, not {IMU_TYPE}; {listed}")


@cache
def _plan() -> CdrPlan:
    return _plan_of(None, is_ros1=False)


def _plan_of(fields: Fields | None, *, is_ros1: bool) -> CdrPlan:
    return plan_with(fields, IMU_TYPE, _FIELDS, is_ros1=is_ros1)


def _readings(columns: Columns, count: int) -> InertialReadings:
    """Return decoded columns without rows that are not finite."""
    good, names = _usable(columns), columns.texts[_FRAME].names
    rates, accelerations = (
        np.asarray(columns.numbers[vector], float)[good] for vector in _VECTORS
    )
    frame = names[0].lstrip("/") if names else ""
    dropped = count - int(np.count_nonzero(good))
    stamps = stamps_of(columns)[good]
    return InertialReadings(stamps, rates, accelerations, frame, undecodable=dropped)


def _usable(columns: Columns) -> Booleans:
    good: Booleans = np.logical_and.reduce(
        [(np.abs(columns.numbers[vector]) <= LARGEST).all(axis=1) for vector in _VECTORS]
    )
    return good
