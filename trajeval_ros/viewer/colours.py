"""The colours of the picture: groundtruth, estimates, and errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats

Colour = tuple[int, int, int]
Colours = NDArray[np.uint8]

BACKGROUND: Colour = (17, 19, 24)
GRID: Colour = (52, 56, 66)
GROUNDTRUTH: Colour = (150, 154, 163)
BAND: Colour = (200, 200, 205)
# The first one is none of those that errors have; the others are Okabe and Ito's, which the
# colour-blind can tell apart.
ESTIMATES: tuple[Colour, ...] = (
    (190, 135, 250),
    (86, 180, 233),
    (230, 159, 0),
    (0, 190, 140),
    (240, 228, 66),
    (213, 94, 0),
)
# From no error to the scale's end; they also differ in how bright they are.
_RAMP: tuple[Colour, ...] = (
    (38, 130, 190),
    (40, 190, 165),
    (250, 215, 70),
    (245, 130, 35),
    (215, 35, 45),
)
_RAMP_WORDS = "blue over yellow to red"


def of_estimate(place: int) -> Colour:
    """Return the colour of the estimate at a place in the list."""
    return ESTIMATES[place % len(ESTIMATES)]


def of_errors(errors: Floats, full_m: float) -> Colours:
    """Return the colours (N, 3) of errors (N,) on a scale from 0 to `full_m`."""
    share = np.clip(np.nan_to_num(errors, nan=np.inf) / full_m, 0.0, 1.0)
    at = np.linspace(0.0, 1.0, len(_RAMP))
    channels = [np.interp(share, at, channel) for channel in np.array(_RAMP).T]
    return np.stack(channels, axis=1).round().astype(np.uint8)


def scale_for(errors: Floats) -> float:
    """Return where the scale ends: a round number that nearly all errors (N,) stay below, m."""
    most = float(np.percentile(errors, 98)) if len(errors) else 0.0
    if not most > 1e-6:
        return 1e-3
    decade = 10.0 ** np.floor(np.log10(most))
    steps = (1.0, 2.0, 3.0, 5.0, 10.0)
    return float(next(step for step in steps if step * decade >= most * 0.999) * decade)


def in_words(full_m: float) -> str:
    """Say what the colours of errors mean."""
    return f"{_RAMP_WORDS}: position error from 0 to {full_m:g} m"
