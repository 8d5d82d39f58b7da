"""Times at which the messages of poses were received."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps, at_rows

LOG, PUBLISH = "log", "publish"  # clocks of a bag: of the recorder, and of the publisher


@dataclass(frozen=True, eq=False)
class ReceiveTimes:
    """When the N messages of poses were received."""

    times: Stamps  # (N,) int64, nanoseconds
    # What the times are: `log` or `publish` times of a bag, `column` of a text file, or `node`
    # for those of a live run.
    by: str = "column"
    # Median and maximum of log time minus publish time, seconds: transport and recording; None if
    # a bag does not have both.
    recording_s: tuple[float, float] | None = None
    body_rates: Floats | None = None  # (N, 3), rad/s, in the body; None if not read
    # (N,) int64, nanoseconds, receive times of the newest corrections, such as map to odom; None
    # if poses are not corrected.
    corrected: Stamps | None = None

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.times)

    def __getitem__(self, rows: Any) -> ReceiveTimes:
        """Return those of a slice, a mask or an array of indices."""
        return at_rows(self, ("times", "body_rates", "corrected"), rows)

    @classmethod
    def of_bag(cls, logged: Stamps, published: Stamps, clock: str = "") -> ReceiveTimes:
        """Return the publish times where they differ from the log times, or the requested ones.

        A recorder that is late delays its log times only. `logged`, `published`: (N,),
        nanoseconds. `clock`: `LOG`, `PUBLISH`, or empty for the default.
        """
        differs = bool((published != logged).any() and (published > 0).all())
        if not differs or clock == LOG:
            return cls(logged, LOG)
        later_s = (logged - published) / 1e9
        recording_s = float(np.median(later_s)), float(later_s.max())
        return cls(published, PUBLISH, recording_s)
