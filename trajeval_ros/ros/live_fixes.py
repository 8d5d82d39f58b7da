"""GNSS fixes of a live run: selection and positions, as for a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.fix_selection import FixRule, fixes_of_rows
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum

ORIGIN_UNKNOWN = (
    "gauge none needs a common frame, and the origin of the fixes is arbitrary; give the origin "
    "of the estimate's frame with datum:=LAT,LON,HEIGHT, or use gauge:=yaw"
)
_NO_HEIGHTS = "the fixes have no height; use gauge:=planar"


class LiveFixes:
    """Selects the fixes of a receiver by their own quality, and converts them to metres."""

    def __init__(self, rule: FixRule | None = None, gauge: Gauge = Gauge.YAW) -> None:
        self.rule = rule or FixRule()  # selects fixes and defines their frame
        self.datum: Datum | None = None  # origin of the frame; None before the first used fix
        needs_datum = gauge is Gauge.NONE and self.rule.datum is None
        self.refused = ORIGIN_UNKNOWN if needs_datum else ""  # why no fix can be used
        self._is_level = gauge is Gauge.PLANAR
        self._lacks_heights = False
        self._antennas: list[str] = []

    @property
    def why_none(self) -> str:
        """Why no fix has been used so far, if parameters are the cause; else empty."""
        if self._lacks_heights and self.datum is None:
            return self.refused or _NO_HEIGHTS
        return self.refused

    def placed(
        self, stamps: Stamps, places: Floats, quality: Floats
    ) -> tuple[Booleans, Floats, Fixes, dict[str, int]]:
        """Return the positions of the used fixes.

        Places (N, 3) are latitude and longitude in degrees and height in metres, with a quality
        (N, 11) as in `PoseColumns`. Returned are which fixes are used, (N,), their positions
        (M, 3), metres, these fixes, and the number of the others by reason.
        """
        fixes = fixes_of_rows(places, quality)
        kept, dropped = self.rule.usable(fixes, level=self._is_level)
        self._lacks_heights |= dropped.get("no_height", 0) > 0
        if kept.any() and self.datum is None and not self.refused:
            try:
                self.datum = self.rule.datum_of(stamps[kept], fixes[kept])
            except InputError as error:
                self.refused = str(error)
        if self.refused:
            dropped["no_frame"] = int(np.count_nonzero(kept))
            kept = np.zeros(len(kept), dtype=bool)
        used = replace(fixes[kept], datum=self.datum)
        positions = used.positions(level=self._is_level) if kept.any() else np.empty((0, 3))
        return kept, positions, used, dropped

    def mixed(self, antennas: list[str]) -> str:
        """Return a warning if fixes of several receivers alternate on the topic; else empty."""
        for antenna in antennas:
            if not self._antennas or self._antennas[-1] != antenna:
                self._antennas = [*self._antennas, antenna][-3:]
        if len(self._antennas) < 3:
            return ""
        names = ", ".join(map(repr, sorted(set(self._antennas))))
        return (
            f"the topic has fixes of several receivers (frame_id {names}) with different "
            "antennas; publish one topic per receiver"
        )
