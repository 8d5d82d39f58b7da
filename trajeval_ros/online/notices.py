"""What a user must know of a live evaluation, and when it begins and ends to be so."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

OK, WARN, ERROR, STALE = range(4)  # as diagnostic_msgs/DiagnosticStatus has them
_BY_GRAVITY = (OK, WARN, STALE, ERROR)  # silence must not hide an error


@dataclass(frozen=True)
class Notice:
    """One sentence for the user.

    Attributes:
        kind: What it is about: alarm, jump, restart, frame, clock, hint, and others.
        level: `OK`, `WARN`, `ERROR` or `STALE`.
        text: The sentence.
        subject: What tells it from others of its kind, such as the quantity of an alarm.
        values: The numbers in it, by name.
    """

    kind: str
    level: int
    text: str
    subject: str = ""
    values: Mapping[str, float | int | str] = field(default_factory=dict)


def gravest_first(notices: Iterable[Notice]) -> list[Notice]:
    """Return notices by their gravity; an error comes before silence."""
    return sorted(notices, key=lambda each: -_BY_GRAVITY.index(each.level))


class Standing:
    """The notices that stand, to tell each once when it begins, gets graver, or ends."""

    def __init__(self) -> None:
        """Create it without any."""
        self._notices: dict[tuple[str, str], Notice] = {}

    def renew(self, notices: Iterable[Notice]) -> list[Notice]:
        """Take all notices that stand now; returns what is new, and as OK what is over."""
        now = {(each.kind, each.subject): each for each in notices if each.level != OK}
        before, self._notices = self._notices, now
        told = [
            each
            for key, each in now.items()
            if key not in before
            or _BY_GRAVITY.index(each.level) > _BY_GRAVITY.index(before[key].level)
        ]
        over = [
            replace(each, level=OK, text=f"no longer: {each.text}")
            for key, each in before.items()
            if key not in now
        ]
        return told + over
