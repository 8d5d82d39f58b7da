"""Notices for the user of a live evaluation, reported when they start and when they end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

OK, WARN, ERROR, STALE = range(4)  # as diagnostic_msgs/DiagnosticStatus has them
_BY_GRAVITY = (OK, WARN, STALE, ERROR)  # an error ranks above a missing message


@dataclass(frozen=True)
class Notice:
    """One sentence for the user.

    Attributes:
        kind: Subject: alarm, jump, restart, frame, clock, hint, and others.
        level: `OK`, `WARN`, `ERROR` or `STALE`.
        text: The sentence.
        subject: Distinguishes notices of one kind, such as the quantity of an alarm.
        values: The numbers in the text, by name.
    """

    kind: str
    level: int
    text: str
    subject: str = ""
    values: Mapping[str, float | int | str] = field(default_factory=dict)


def gravest_first(notices: Iterable[Notice]) -> list[Notice]:
    """Return notices in order of decreasing severity."""
    return sorted(notices, key=lambda notice: -_BY_GRAVITY.index(notice.level))


class Standing:
    """The active notices. Each is reported once when it starts, gets more severe, or ends."""

    def __init__(self) -> None:
        """Create it without notices."""
        self._notices: dict[tuple[str, str], Notice] = {}

    def renew(self, notices: Iterable[Notice]) -> list[Notice]:
        """Take all active notices; returns new ones, and ended ones with level OK."""
        now = {(notice.kind, notice.subject): notice for notice in notices if notice.level != OK}
        before, self._notices = self._notices, now
        started = [
            notice
            for key, notice in now.items()
            if key not in before
            or _BY_GRAVITY.index(notice.level) > _BY_GRAVITY.index(before[key].level)
        ]
        ended = [
            replace(notice, level=OK, text=f"no longer: {notice.text}")
            for key, notice in before.items()
            if key not in now
        ]
        return started + ended
