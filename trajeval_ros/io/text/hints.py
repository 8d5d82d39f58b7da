"""Information about text files that the user states: column names and frame rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.text.layouts import layout_of


@dataclass(frozen=True)
class TextHints:
    """Information about text files that the user states.

    Attributes:
        columns: Names of the columns (`layouts.NAMES`); () to recognise them.
        frame_rate_hz: Rows per second of files without timestamps; None if unknown.

    Raises:
        SettingsError: A name is unknown or repeated, no position is named, or the rate is not
            greater than zero.
    """

    columns: tuple[str, ...] = ()
    frame_rate_hz: float | None = None

    def __post_init__(self) -> None:
        """Check the names and the rate.

        Raises:
            SettingsError: As for the class.
        """
        if self.columns:
            layout_of(self.columns)
        rate = self.frame_rate_hz
        if rate is not None and not (math.isfinite(rate) and rate > 0.0):
            raise SettingsError(f"the frame rate must be greater than zero, not {rate:g}")

    @property
    def of_reference(self) -> TextHints:
        """Hints for the groundtruth or reference: the rate only, since its columns can differ."""
        return TextHints(frame_rate_hz=self.frame_rate_hz)

    @classmethod
    def of(cls, columns: str | None, frame_rate_hz: float | None) -> TextHints:
        """Return hints from options of the command line.

        Args:
            columns: Names separated by spaces or commas; None to recognise them.
            frame_rate_hz: As the attribute.

        Raises:
            SettingsError: As for the class, or `columns` has no name.
        """
        names = () if columns is None else tuple(columns.replace(",", " ").split())
        if columns is not None and not names:
            raise SettingsError("--columns is empty; name at least x, y and z")
        return cls(names, frame_rate_hz)


NO_HINTS = TextHints()
