"""The black box: on an alarm, the messages before and after it are written as a clip."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.write_clip import require_clip_libraries, write_clip
from trajeval_ros.io.live.clip_folder import ClipFolder
from trajeval_ros.online.notices import Notice
from trajeval_ros.ros.background import BackgroundTask
from trajeval_ros.ros.message_ring import MessageRing
from trajeval_ros.ros.subscriptions import TopicInput

if TYPE_CHECKING:
    from rclpy.node import Node

MEGABYTE = 1_000_000
_MOST_CLIPS = 100
_MOST_CAUSES = 100  # alarms in the JSON file of a clip
# Returns additional fields of a clip's JSON file.
About = Callable[[], Mapping[str, Any]]
_SPAN = re.compile(r"(\d+(?:\.\d+)?)s\+(\d+(?:\.\d+)?)s")


@dataclass(frozen=True)
class BlackBoxSettings:
    """Settings of the black box.

    Attributes:
        before_s: Seconds before an alarm.
        after_s: Seconds after it.
        topics: Topics of the clips.
        folder: Folder for clips.
        memory: Largest size of the stored messages, bytes.
        disk: Largest size of all clips in the folder, bytes; the oldest ones are removed.
        pause_s: Least time from an alarm with a clip to the next one, seconds.
    """

    before_s: float
    after_s: float
    topics: tuple[str, ...]
    folder: Path
    memory: int
    disk: int
    pause_s: float

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> BlackBoxSettings | None:
        """Return the settings in the parameters; None if they request no black box.

        Raises:
            SettingsError: A value is not valid.
            InputError: The library that writes clips is missing.
        """
        text = values["black_box"]
        if not text:
            return None
        span = _SPAN.fullmatch(text.replace(" ", ""))
        if span is None or not float(span[1]) + float(span[2]):
            raise SettingsError(
                "parameter black_box must be the seconds before and after an alarm, as in "
                f"30s+10s, not {text!r}"
            )
        require_clip_libraries()
        own = [values["groundtruth_topic"], values["imu_topic"], values["map_to_odom"]]
        all_own = [*values["estimate_topics"], *values["watch_with"], *own]
        named = values["black_box_topics"] or all_own
        topics = dict.fromkeys(each.partition(":")[0] for each in named if each)
        if "/tf" in topics:
            topics["/tf_static"] = None
        return cls(
            float(span[1]),
            float(span[2]),
            tuple(topics),
            Path(values["black_box_folder"]).expanduser().resolve(),
            round(values["black_box_memory"] * MEGABYTE),
            round(values["black_box_disk"] * MEGABYTE),
            values["black_box_pause"],
        )


@dataclass
class _Due:
    """A clip whose last messages have not arrived yet."""

    at_ns: int
    causes: list[Notice]
    alarm_ns: int
    about: About


class ClipWriter:
    """Stores messages, and writes a clip of them some time after an alarm.

    Attributes:
        ring: The stored messages.
        news: Sentences that are not reported yet, and whether they are warnings.
    """

    def __init__(self, settings: BlackBoxSettings, now_ns: Callable[[], int] = time.time_ns):
        """Create it with an empty ring.

        Args:
            settings: Topics, spans and limits.
            now_ns: The clock of the times of reception.

        Raises:
            InputError: The folder for clips can't be made.
        """
        self._settings, self._now_ns = settings, now_ns
        self._folder = ClipFolder(settings.folder, _MOST_CLIPS, settings.disk)
        # A message waits for up to one tick before it is stored.
        self.ring = MessageRing(settings.before_s + settings.after_s + 1.0, settings.memory)
        self.news: list[tuple[str, bool]] = []
        self._due: _Due | None = None
        self._free_at_ns = 0
        self._without = 0  # alarms without a clip since the last clip
        self._task: BackgroundTask[tuple[str, bool]] = BackgroundTask(1.0)

    def trigger(self, cause: Notice, about: About) -> None:
        """Start a clip for an alarm.

        An alarm before the end of another clip is added to that clip. An alarm within the pause
        has no clip and is counted.

        Args:
            cause: The alarm.
            about: Returns further fields of the JSON file; called at the end of the clip.
        """
        now_ns = self._now_ns()
        if self._due is not None:
            if len(self._due.causes) < _MOST_CAUSES:
                self._due.causes.append(cause)
        elif now_ns < self._free_at_ns:
            self._without += 1
        else:
            after_ns = round(self._settings.after_s * NANOSECONDS)
            self._free_at_ns = now_ns + round(self._settings.pause_s * NANOSECONDS)
            self._due = _Due(now_ns + after_ns, [cause], now_ns, about)

    def renew(self, *, at_end: bool = False) -> None:
        """Remove old messages, and write the clip that is due.

        Args:
            at_end: Whether the node ends: write the waiting clip now, and wait until it is done.
        """
        self.ring.forget(self._now_ns())
        told = self._task.wait() if at_end else self._task.take()
        if told is not None:
            self.news.append(told)
        is_due = self._due is not None and self._now_ns() >= self._due.at_ns and self._task.is_due
        if self._due is None or not (at_end or is_due):
            return
        due, self._due = self._due, None
        begin_ns = due.alarm_ns - round(self._settings.before_s * NANOSECONDS)
        topics = self.ring.between(begin_ns, due.at_ns)
        about = {
            "alarm_ns": due.alarm_ns,
            "causes": [_as_mapping(each) for each in due.causes],
            "alarms_without_clip_before": self._without,
            "messages_forgotten_for_memory": self.ring.forgotten,
            **due.about(),
        }
        self._without = 0
        path = self._folder.new_clip(due.alarm_ns, due.causes[0].subject)

        def write() -> tuple[str, bool]:
            try:
                write_clip(path, topics, about)
                removed = self._folder.make_room()
            except InputError as error:
                return str(error), True
            gone = f"; the oldest went: {', '.join(removed)}" if removed else ""
            return f"clip of {due.causes[0].subject} is in {path}{gone}", False

        self._task.start(write)
        if at_end:
            self.renew(at_end=True)


def _as_mapping(notice: Notice) -> dict[str, Any]:
    return {
        "kind": notice.kind,
        "level": notice.level,
        "subject": notice.subject,
        "text": notice.text,
        **notice.values,
    }


class BlackBox:
    """Subscribes to the topics of the clips, and passes their messages to the writer."""

    def __init__(self, node: Node, settings: BlackBoxSettings, values: Mapping[str, Any]) -> None:
        """Start to search for publishers.

        Args:
            node: The subscribing node.
            settings: Topics, spans and limits.
            values: The parameters, for the JSON file.

        Raises:
            InputError: The folder for clips can't be made.
        """
        self._writer = ClipWriter(settings)
        self._values = dict(values)
        self._inputs = [TopicInput(node, each, None, is_optional=True) for each in settings.topics]

    def match(self) -> list[tuple[str, bool]]:
        """Connect to the current publishers; returns sentences for the log."""
        told = [(f"black box: {said}", False) for each in self._inputs if (said := each.match())]
        news, self._writer.news = self._writer.news, []
        return told + news

    def tick(self) -> None:
        """Store the messages that have arrived, and write the clip that is due."""
        self._take()
        self._writer.renew()

    def trigger(self, cause: Notice, history: About) -> None:
        """Start a clip for an alarm.

        Args:
            cause: The alarm.
            history: Returns the signals of the last minute; empty without a watch.
        """
        self._writer.trigger(cause, lambda: {"signals": history(), "parameters": self._values})

    def conclude(self) -> list[tuple[str, bool]]:
        """Write the waiting clip at the end of the node; returns sentences for the log."""
        self._take()
        self._writer.renew(at_end=True)
        return self._writer.news

    def _take(self) -> None:
        for each in self._inputs:
            taken = each.take()
            if taken.payloads:
                self._writer.ring.add(each.topic, each.type, taken, is_latched=each.is_latched)
