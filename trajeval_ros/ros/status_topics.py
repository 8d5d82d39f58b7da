"""What the node reports in any mode: events, diagnostics and the log.

Of remarks that repeat, the first ones are reported, then a count.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.online.error_topics import DIAGNOSTIC_LEVELS, ROBOT, status_texts

if TYPE_CHECKING:
    from rclpy.node import Node

_FIRST = 3  # reported remarks of a kind
_SPAN_S = 10.0  # within this time
_LONGEST_S = 3600.0


@dataclass
class _Kind:
    until_s: float  # end of the present span
    span_s: float
    number: int = 0  # remarks in this span
    newest: Remark | None = None  # the newest one that was not reported


class RepeatedRemarks:
    """Reports three remarks of a kind in ten seconds; a count replaces the others.

    A kind is a code and a subject of one source. While it repeats, its spans get longer, so that
    the events that came first are kept for late subscribers.
    """

    def __init__(self) -> None:
        self._kinds: dict[tuple[str, str, str], _Kind] = {}

    def may_report(self, about: str, remark: Remark, now_s: float) -> bool:
        """Return whether a remark about a source is reported at a time; else it is counted."""
        key = about, remark.code, remark.subject
        kind = self._kinds.setdefault(key, _Kind(now_s + _SPAN_S, _SPAN_S))
        kind.number += 1
        if kind.number <= _FIRST:
            return True
        kind.newest = remark
        return False

    def counts(self, now_s: float) -> list[tuple[str, Remark]]:
        """Return the counts of the spans that end by now, with the sources they are about."""
        remarks = []
        for key, kind in list(self._kinds.items()):
            if now_s < kind.until_s:
                continue
            if kind.newest is None:
                del self._kinds[key]
                continue
            more = kind.number - _FIRST
            prefix = (
                f"{counted(more, 'more event')} of this kind in {kind.span_s:.0f} s; the newest: "
            )
            values = {**kind.newest.values, "more": more}
            remarks.append(
                (key[0], replace(kind.newest, text=prefix + kind.newest.text, values=values))
            )
            span_s = min(2.0 * kind.span_s, _LONGEST_S)
            self._kinds[key] = _Kind(now_s + span_s, span_s)
        return remarks


def advertise(node: Node, kind: Any, topic: str, depth: int = 10, *, latched: bool = False) -> Any:
    """Return a publisher without event handlers.

    rclpy's default handlers report subscribers with an incompatible quality of service. They are
    two entities per publisher in the executor's wait set. With a hundred publishers, they take
    most of its CPU time. The node of such a subscriber reports the incompatibility, too.
    """
    from rclpy.node import PublisherEventCallbacks  # defined elsewhere in Humble
    from rclpy.qos import DurabilityPolicy, QoSProfile

    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return node.create_publisher(
        kind,
        topic,
        QoSProfile(depth=depth, durability=durability),
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )


def status_message(
    node: Node, level: Level, about: str, text: str, values: Mapping[str, Any]
) -> Any:
    """Return the message without values that are None; control characters are escaped.

    Names are those of diagnostic_updater, without a leading slash. The hardware is the robot: the
    node's namespace, if it has one.
    """
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=bytes([DIAGNOSTIC_LEVELS[level]]),
        name=f"{node.get_fully_qualified_name().lstrip('/')}: {about}",
        hardware_id=node.get_namespace().strip("/") or ROBOT,
        message=one_line(text),
        values=[
            KeyValue(key=key, value=one_line(value)) for key, value in status_texts(values).items()
        ],
    )


_KEPT = 100  # events for late subscribers


class EventTopic:
    """Publishes remarks as `diagnostic_msgs/DiagnosticStatus`: text, level, and named values.

    Remarks that repeat are counted.
    """

    def __init__(self, node: Node) -> None:
        from diagnostic_msgs.msg import DiagnosticStatus

        self._node = node
        self._publisher = advertise(node, DiagnosticStatus, "~/event", _KEPT, latched=True)
        self._repeated = RepeatedRemarks()

    def publish(self, about: str, remark: Remark) -> bool:
        """Publish a remark about an estimate or the groundtruth, by its name.

        Returns whether it was published; a remark that repeats is counted instead.
        """
        reported = self._repeated.may_report(about, remark, time.monotonic())
        if reported:
            self._send(about, remark)
        return reported

    def publish_counts(self) -> list[tuple[str, Remark]]:
        """Publish how often remarks have repeated; return these counts with their subjects."""
        counts = self._repeated.counts(time.monotonic())
        for about, remark in counts:
            self._send(about, remark)
        return counts

    def _send(self, about: str, remark: Remark) -> None:
        values = {
            "time_ns": self._node.get_clock().now().nanoseconds,
            "kind": remark.code,
            "subject": remark.subject or None,
            **remark.values,
        }
        message = status_message(self._node, remark.level, about, remark.text, values)
        self._publisher.publish(message)


class DiagnosticsTopic:
    """Publishes statuses as `diagnostic_msgs/DiagnosticArray`."""

    def __init__(self, node: Node) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self._node = node
        self._publisher = advertise(node, DiagnosticArray, "/diagnostics")

    def publish(self, statuses: Sequence[Any]) -> None:
        """Publish statuses (`diagnostic_msgs/DiagnosticStatus`) with the present time."""
        from diagnostic_msgs.msg import DiagnosticArray

        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status += statuses
        self._publisher.publish(message)


def log(node: Node, text: str, level: Level = Level.NOTE) -> None:
    """Log a sentence."""
    logger, line = node.get_logger(), one_line(text)
    if level == Level.NOTE:  # rclpy needs a separate call for every severity
        logger.info(line)
    elif level == Level.ERROR:
        logger.error(line)
    else:
        logger.warning(line)
