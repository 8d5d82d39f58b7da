"""Time spans of trajectories, as users specify them."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_LATEST_S = 4_000_000_000  # the sum of two still fits int64 nanoseconds


@dataclass(frozen=True)
class TimeSpan:
    """A period of time, both ends included.

    Attributes:
        start_ns: Nanoseconds after the first timestamp, or a timestamp; None for the first state.
        end_ns: Likewise; None for the last state.
        absolute_start: Whether `start_ns` is a timestamp.
        absolute_end: Whether `end_ns` is a timestamp.

    Example:
        >>> from trajeval_ros.geometry.time_span import TimeSpan
        >>> TimeSpan.parse("10", "+30").stamps(first_ns=5_000_000_000)
        (15000000000, 45000000000)
    """

    start_ns: int | None = None
    end_ns: int | None = None
    absolute_start: bool = False
    absolute_end: bool = False

    @classmethod
    def parse(cls, start: str | None, end: str | None) -> TimeSpan | None:
        """Parse "10" (seconds after the first timestamp), "@1403636580.5" or, as an end, "+30".

        Args:
            start: None for the first state; "@..." is a timestamp.
            end: None for the last state; "+30" is 30 seconds after the start.

        Returns:
            None if both are None.

        Raises:
            SettingsError: A text is not valid, or the end is before the start.
        """
        if start is None and end is None:
            return None
        start_ns, absolute_start = (None, False) if start is None else _time(start, "start")
        if end is None:
            return cls(start_ns, None, absolute_start)
        end_ns, absolute_end = _time(end, "end")
        if end.strip().startswith("+"):
            end_ns, absolute_end = end_ns + (start_ns or 0), absolute_start
        if start_ns is not None and absolute_start is absolute_end and end_ns < start_ns:
            raise SettingsError(f"end {end} is before start {start}")
        return cls(start_ns, end_ns, absolute_start, absolute_end)

    def stamps(self, first_ns: int) -> tuple[int | None, int | None]:
        """Return the first and the last timestamp, None for an open end.

        Args:
            first_ns: The timestamp that relative times count from.
        """
        start, end = self.start_ns, self.end_ns
        if start is not None and not self.absolute_start:
            start += first_ns
        if end is not None and not self.absolute_end:
            end += first_ns
        return start, end

    def cut(self, trajectory: Trajectory, first_ns: int, offset_ns: int = 0) -> Trajectory:
        """Return the states in the time span.

        Args:
            trajectory: States with timestamps.
            first_ns: The timestamp that relative times count from.
            offset_ns: Added to the trajectory's timestamps for the comparison only.

        Raises:
            InputError: The trajectory has no timestamps, or no state in the time span.
        """
        if not trajectory.stamped:
            raise InputError("no timestamps, which a time span needs")
        start, end = self.stamps(first_ns)
        stamps = trajectory.stamps
        inside = stamps == stamps
        if start is not None:
            inside &= stamps >= start - offset_ns
        if end is not None:
            inside &= stamps <= end - offset_ns
        if not inside.any():
            raise InputError(
                f"no pose in the time span: its timestamps are from {_seconds(stamps.min())} to "
                f"{_seconds(stamps.max())} s"
            )
        return trajectory[inside]


def _time(text: str, what: str) -> tuple[int, bool]:
    """Return a time in nanoseconds, and whether it is a timestamp."""
    absolute = text.strip().startswith("@")
    try:
        seconds = Decimal(text.strip().removeprefix("@"))
    except InvalidOperation:
        seconds = Decimal("nan")
    if not (seconds.is_finite() and abs(seconds) < _LATEST_S) or (seconds < 0 and not absolute):
        raise SettingsError(
            f"{what} {text!r} is not valid; give seconds after the first timestamp, as in 10.5, "
            "a timestamp in seconds, as in @1403636580.5"
            + (", or seconds after the start, as in +30" if what == "end" else "")
        )
    return round(seconds * NANOSECONDS), absolute


def _seconds(stamp: int) -> str:
    return f"{Decimal(int(stamp)) / NANOSECONDS:.3f}"
