"""Information about text files that the user states: columns by side, and frame rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.text.names import layout_of

GROUNDTRUTH, ESTIMATE = "groundtruth", "estimate"
_SIDES = (GROUNDTRUTH, ESTIMATE, "reference")


@dataclass(frozen=True)
class TextHints:
    """Information about text files that the user states."""

    columns: tuple[str, ...] = ()  # names of the columns (`names.NAMES`); () to recognise them
    # Rows per second of files without timestamps; None if unknown.
    frame_rate_hz: float | None = None
    side: str = ""  # "groundtruth" if --columns needs this prefix for the file, else ""

    def __post_init__(self) -> None:
        if self.columns:
            layout_of(self.columns)
        rate = self.frame_rate_hz
        if rate is not None and not (math.isfinite(rate) and rate > 0.0):
            raise SettingsError(f"the frame rate must be greater than zero, not {rate:g}")

    def in_message(self, text: str) -> str:
        """Return a message with the option that names the columns of this file for `{option}`."""
        prefix = f"{self.side}: " if self.side else ""
        text = text.replace("{option} '", f"--columns '{prefix}")
        return text.replace("{option}", f"--columns '{prefix}NAMES'" if prefix else "--columns")


class SideHints(NamedTuple):
    """Hints for the two sides of an evaluation."""

    groundtruth: TextHints  # also of the reference of other verbs
    estimate: TextHints

    @classmethod
    def of(cls, columns: str | Sequence[str] | None, frame_rate_hz: float | None) -> SideHints:
        """Return hints from options of the command line.

        `columns`: values of --columns, names between spaces or commas. A value that starts with
        `groundtruth:` is of the groundtruth or reference; others are of the estimates.

        Raises:
            SettingsError: A side is named twice or not at all, or a name is unknown.
        """
        values = [columns] if isinstance(columns, str) else list(columns or ())
        names: dict[str, tuple[str, ...]] = {}
        for value in values:
            before, mark, after = value.partition(":")
            side = before.strip() if mark else ESTIMATE
            if side not in _SIDES:
                raise SettingsError(
                    f"--columns has no side {side!r}; use groundtruth: or estimate:, or no prefix "
                    "for the estimates"
                )
            side = ESTIMATE if side == ESTIMATE else GROUNDTRUTH
            if side in names:
                raise SettingsError(
                    f"--columns names the columns of the {side} twice; name them once"
                )
            names[side] = tuple((after if mark else value).replace(",", " ").split())
            if not names[side]:
                raise SettingsError("--columns is empty; name at least x, y and z")
        return cls(
            TextHints(names.get(GROUNDTRUTH, ()), frame_rate_hz, GROUNDTRUTH),
            TextHints(names.get(ESTIMATE, ()), frame_rate_hz),
        )


NO_HINTS = TextHints()
NO_SIDES = SideHints(TextHints(side=GROUNDTRUTH), NO_HINTS)
