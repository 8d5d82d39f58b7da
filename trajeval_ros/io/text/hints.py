"""What a user says of text files that isn't in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.text.layouts import layout_of


@dataclass(frozen=True)
class TextHints:
    """What a user says of text files beyond what is in them.

    Attributes:
        columns: Names of the columns (`layouts.NAMES`); () to recognise them.
        frame_rate_hz: Rows a second of files without stamps; None if it isn't known.
    """

    columns: tuple[str, ...] = ()
    frame_rate_hz: float | None = None

    def __post_init__(self) -> None:
        """Refuse names that are none, and a rate that is none.

        Raises:
            SettingsError: There is one.
        """
        if self.columns:
            layout_of(self.columns)
        rate = self.frame_rate_hz
        if rate is not None and not (math.isfinite(rate) and rate > 0.0):
            raise SettingsError(f"the frame rate must be greater than zero, not {rate:g}")

    @property
    def of_reference(self) -> TextHints:
        """What of them holds of the groundtruth or reference, too: it has columns of its own."""
        return TextHints(frame_rate_hz=self.frame_rate_hz)

    @classmethod
    def of(cls, columns: str | None, frame_rate_hz: float | None) -> TextHints:
        """Return them from the words of the command line.

        Args:
            columns: Names with spaces or commas between them; None to recognise them.
            frame_rate_hz: As the attribute.

        Raises:
            SettingsError: As for the class, or there is no name.
        """
        names = () if columns is None else tuple(columns.replace(",", " ").split())
        if columns is not None and not names:
            raise SettingsError("--columns is empty; name at least x, y and z")
        return cls(names, frame_rate_hz)


NO_HINTS = TextHints()
