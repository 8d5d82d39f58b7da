"""Sentences of NMEA 0183, with the places that they name."""

from __future__ import annotations

import functools
import operator

import numpy as np
from fix_runs import places_of

POSITIONS = np.random.default_rng(0).uniform(-200.0, 200.0, (30, 3))
PLACES = places_of(POSITIONS)


def sentence(body: str) -> str:
    checksum = functools.reduce(operator.xor, body.encode(), 0)
    return f"${body}*{checksum:02X}"


def gga(seconds: float, place: np.ndarray, quality: int = 4, geoid: float = 47.2) -> str:
    minutes, rest = divmod(seconds % 86_400, 60.0)
    hours, minutes = divmod(int(minutes), 60)
    latitude, longitude, height = place
    words = [f"GNGGA,{hours:02d}{minutes:02d}{rest:05.2f}"]
    for value, letters, width in ((latitude, "NS", 2), (longitude, "EW", 3)):
        degrees, part = divmod(abs(value), 1.0)
        words += [f"{int(degrees):0{width}d}{60.0 * part:011.8f}", letters[int(value < 0)]]
    words += [f"{quality},12,0.7,{height - geoid:.4f},M,{geoid:.4f},M,1.0,0001"]
    return sentence(",".join(words))
