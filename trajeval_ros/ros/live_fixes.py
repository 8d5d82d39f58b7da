"""GNSS fixes while they come: which are used, and where they are, as of recorded ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.fixes import FixRule
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.io.fix_rows import fixes_of_rows

ORIGIN_UNKNOWN = (
    "gauge none needs a common frame, and the origin of the fixes is arbitrary; give the origin "
    "of the estimate's frame with datum:=LAT,LON,HEIGHT, or use gauge:=yaw"
)


class LiveFixes:
    """Judges the fixes of a receiver by what they say of themselves, and brings them to metres.

    Attributes:
        rule: Which are used, in which frame.
        datum: Where the frame's origin is; None before the first fix that is used.
        refused: Why none is used at all; empty if they are.
    """

    def __init__(self, rule: FixRule | None = None, *, wants_datum: bool = False) -> None:
        """Create it.

        Args:
            rule: Which fixes are used.
            wants_datum: Whether the frame must be one that somebody chose.
        """
        self.rule = rule or FixRule()
        self.datum: Datum | None = None
        self.refused = ORIGIN_UNKNOWN if wants_datum and self.rule.datum is None else ""
        self._antennas: list[str] = []

    def placed(
        self, stamps: Stamps, places: Floats, quality: Floats
    ) -> tuple[Booleans, Floats, dict[str, int]]:
        """Return where fixes are that are used.

        Args:
            stamps: (N,), nanoseconds.
            places: (N, 3), latitude and longitude in degrees, height in metres.
            quality: (N, 11), as `PoseColumns` has it.

        Returns:
            Which of them are used, (N,), where these are, (M, 3), metres, and how many are not, by
            reason.
        """
        fixes = fixes_of_rows(places, quality)
        kept, dropped = self.rule.usable(fixes)
        # Those to come may all have heights.
        flat = kept & np.isnan(fixes.places[:, 2])
        dropped["no_height"] = dropped.get("no_height", 0) + int(np.count_nonzero(flat))
        kept &= ~flat
        if kept.any() and self.datum is None and not self.refused:
            try:
                self.datum = self.rule.datum_of(stamps[kept], fixes[kept])
            except InputError as error:
                self.refused = str(error)
        if self.refused:
            dropped["no_frame"] = int(np.count_nonzero(kept))
            kept = np.zeros(len(kept), dtype=bool)
        if not kept.any():
            return kept, np.empty((0, 3)), dropped
        return kept, replace(fixes[kept], datum=self.datum).positions(), dropped

    def mixed(self, antennas: list[str]) -> str:
        """Return which receivers take turns on the topic; empty while none do.

        Args:
            antennas: The frames of new fixes, as they follow each other.
        """
        for each in antennas:
            if not self._antennas or self._antennas[-1] != each:
                self._antennas = [*self._antennas, each][-3:]
        if len(self._antennas) < 3:
            return ""
        names = ", ".join(map(repr, sorted(set(self._antennas))))
        return (
            f"the topic has fixes of several receivers (frame_id {names}) with different "
            "antennas; publish one topic per receiver"
        )
