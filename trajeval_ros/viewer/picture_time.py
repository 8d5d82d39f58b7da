"""The time of a live picture, which continues when timestamps step back."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

_NEVER = np.iinfo(np.int64).min


class PictureTime:
    """The time that all streams of a picture share.

    A viewer shows the data of the newest time, and plots in order of time. If a bag is played in a
    loop, the second loop would therefore be hidden behind the first one. It is drawn after the
    first one instead: at its timestamps plus a shift.

    Attributes:
        newest: Newest time, nanoseconds.
        shift_ns: Newest shift, a multiple of one second.
    """

    def __init__(self) -> None:
        """Create it without a shift."""
        self.newest = _NEVER
        self.shift_ns = 0

    def shift_past(self, stamp: int, last: int) -> int:
        """Return a shift that moves a timestamp past the last time of its stream.

        Streams that step back together get the same shift. A new one is made only if the newest
        one does not suffice.
        """
        if stamp + self.shift_ns < last:
            self.shift_ns = ((self.newest - stamp) // NANOSECONDS + 2) * NANOSECONDS
        return self.shift_ns


class StreamTime:
    """The times of one stream in the picture.

    Attributes:
        shift_ns: Its present shift.
    """

    def __init__(self, picture: PictureTime) -> None:
        """Create it before the first timestamp."""
        self._picture, self._last = picture, _NEVER
        self.shift_ns = 0

    def begin_segment(self, stamp: int) -> int:
        """Return the time of the first timestamp of a segment, which may be an earlier one."""
        if stamp + self.shift_ns < self._last:
            self.shift_ns = self._picture.shift_past(stamp, self._last)
        return stamp + self.shift_ns

    def at(self, stamps: Stamps) -> Stamps:
        """Return the times of new timestamps (N,), N > 0, nanoseconds."""
        times = stamps + self.shift_ns
        self._last = int(times[-1])
        self._picture.newest = max(self._picture.newest, self._last)
        return times
