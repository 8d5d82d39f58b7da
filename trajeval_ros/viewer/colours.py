"""The colours of the picture: groundtruth, estimates, and errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.formatting import palette
from trajeval_ros.geometry.arrays import Floats

Colour = tuple[int, int, int]
Colours = NDArray[np.uint8]

BACKGROUND: Colour = (17, 19, 24)
GRID: Colour = (52, 56, 66)
POINTS: Colour = (86, 96, 118)
GROUNDTRUTH: Colour = (222, 224, 230)
BAND: Colour = (200, 200, 205)
ESTIMATES: tuple[Colour, ...] = tuple(map(palette.rgb, palette.ESTIMATES_ON_DARK))
_RAMP = np.array([palette.rgb(item) for item in palette.RAMP])


def of_estimate(place: int) -> Colour:
    """Return the colour of the estimate at an index of the list."""
    return ESTIMATES[place % len(ESTIMATES)]


def of_fix(status: int) -> Colour:
    """Return the colour of a GNSS fix, by the status of its message."""
    place = palette.FIX_STATUS_PLACES.get(status)
    return GROUNDTRUTH if place is None else of_estimate(place)


def of_errors(errors: Floats, full_m: float) -> Colours:
    """Return the colours (N, 3) of errors (N,) on a scale from 0 to `full_m`."""
    share = np.clip(np.nan_to_num(errors, nan=np.inf) / full_m, 0.0, 1.0)
    at = np.linspace(0.0, 1.0, len(_RAMP))
    channels = [np.interp(share, at, channel) for channel in _RAMP.T]
    return np.stack(channels, axis=1).round().astype(np.uint8)


def scale_for(errors: Floats) -> float:
    """Return the end of the colour scale, m: a round number above nearly all errors (N,)."""
    most = float(np.percentile(errors, 98)) if len(errors) else 0.0
    if not most > 1e-6:
        return 1e-3
    decade = 10.0 ** np.floor(np.log10(most))
    steps = (1.0, 2.0, 3.0, 5.0, 10.0)
    return float(next(step for step in steps if step * decade >= most * 0.999) * decade)


_LEAST_USED = 0.2  # of a scale that lasts


def lasting_scale(errors: Floats, present_m: float | None) -> float:
    """Return the present end of the scale, m, while it suits errors (N,), else a new one."""
    wanted_m = scale_for(errors)
    lasts = present_m is not None and _LEAST_USED * present_m <= wanted_m <= present_m
    return present_m if lasts and present_m is not None else wanted_m
