"""From the words of the command line to what is to be calibrated."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.calibration.apply import Wanted
from trajeval_ros.exceptions import SettingsError

NONE, AUTO = "none", "auto"


def parse_offset(text: str | None) -> float | None:
    """Read `--time-offset` as seconds; None for `auto` and for nothing.

    Raises:
        SettingsError: It is neither a number nor `auto`.
    """
    if text is None or text == AUTO:
        return None
    try:
        return float(text)
    except ValueError:
        raise SettingsError(
            f"--time-offset must be a number of seconds or auto, not {text!r}"
        ) from None


def parse_wanted(time_offset: str | None, hand_eye: str) -> Wanted:
    """Read `--time-offset` and `--hand-eye`.

    Raises:
        InputError: A hand-eye file that can't be read.
    """
    offset = time_offset == AUTO
    if hand_eye in (NONE, AUTO):
        return Wanted(offset=offset, hand_eye=hand_eye == AUTO)
    from trajeval_ros.io.hand_eye_file import read_hand_eye

    return Wanted(offset=offset, known=read_hand_eye(Path(hand_eye)), source=hand_eye)
