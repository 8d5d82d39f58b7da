"""Lengths of sub-trajectories in metres, seconds, percent, frames or angles."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError

UNITS = ("m", "s", "%", "f", "deg", "rad")


_EXAMPLES = "8 or 8m (metres), 1s (seconds), 10f (frames), 5deg or 0.1rad (of rotation) or 10%"


@dataclass(frozen=True)
class Length:
    """The length of sub-trajectories.

    Attributes:
        value: The number in its unit.
        unit: `m`, of the path; `s`; `%`, of the whole path; `f`, frames, which are paired states;
            `deg` or `rad`, of rotation.

    Raises:
        SettingsError: An unknown unit, or a value that is not positive.

    Example:
        >>> from trajeval_ros import Length
        >>> Length(8, "m") == Length.of(8) == Length.parse("8m")
        True
    """

    value: float
    unit: str

    def __post_init__(self) -> None:
        """Refuse unknown units and values that are not positive."""
        if self.unit not in UNITS:
            raise SettingsError(
                f"the unit of a length must be one of {', '.join(UNITS)}, not {self.unit!r}"
            )
        if not (np.isfinite(self.value) and self.value > 0.0):
            raise SettingsError(f"a length must be positive, not {self.text}")
        if self.unit == "f" and self.value != round(self.value):
            raise SettingsError(f"a length in frames must be a whole number, not {self.value:g}f")

    @property
    def in_metres(self) -> bool:
        """Whether it is a distance, so that drift is defined."""
        return self.unit in ("m", "%")

    @property
    def turns(self) -> bool:
        """Whether it is a rotation."""
        return self.unit in ("deg", "rad")

    @property
    def radians(self) -> float:
        """The rotation in radians; only for `deg` and `rad`."""
        return float(np.radians(self.value)) if self.unit == "deg" else self.value

    @property
    def text(self) -> str:
        """The length as text for readers: 8 m, 1 s, 10 %, 1 frame, 5 deg."""
        unit = self.unit
        if unit == "f":
            unit = "frame" if self.value == 1.0 else "frames"
        return f"{self.value:g} {unit}"

    @classmethod
    def parse(cls, text: str) -> Length:
        """Parse "8", "8m", "1s", "10f", "5deg", "0.1rad" or "10%"."""
        pattern = rf"\s*([0-9.]+(?:e-?[0-9]+)?)\s*({'|'.join(UNITS)})?\s*"
        match = re.fullmatch(pattern, text)
        if match is None:
            raise SettingsError(f"{text!r} is not a length; give {_EXAMPLES} (of the path)")
        try:
            return cls(float(match[1]), match[2] or "m")
        except ValueError:
            raise SettingsError(f"{text!r} is not a length") from None

    @classmethod
    def of(cls, length: Length | float | str) -> Length:
        """Return a length from metres, a text or a length.

        Raises:
            SettingsError: The value is not valid.
        """
        if isinstance(length, Length):
            return length
        if isinstance(length, str):
            return cls.parse(length)
        if isinstance(length, bool) or not isinstance(length, (int, float, np.number)):
            raise SettingsError(
                f"{length!r} is not a length; give metres as a number, or a text such as "
                f"{_EXAMPLES}"
            )
        return cls(float(length), "m")

    def __str__(self) -> str:
        """Return the text that `parse` accepts."""
        return f"{self.value:g}{self.unit}"


def parse_lengths(text: str) -> tuple[Length, ...]:
    """Parse "8,16,24", "1s,5s", "1f,10f", "5deg", "10%,20%" or "none"."""
    if text.strip() == "none":
        return ()
    lengths = tuple(Length.parse(part) for part in text.split(","))
    if len(set(lengths)) < len(lengths):
        raise SettingsError(f"a length is given twice in {text!r}; remove one")
    return lengths
