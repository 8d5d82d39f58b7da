"""Limit of remarks that repeat: the first ones are reported, then a count."""

from __future__ import annotations

from dataclasses import dataclass, replace

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark

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
