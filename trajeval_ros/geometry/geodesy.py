"""Conversion of latitude, longitude and height to a local east-north-up frame (WGS 84).

The frame is tangent to the ellipsoid at its datum. It is rigid, so that lengths and angles are
true. It is no map projection such as UTM, whose grid north differs from north.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats

_SEMI_MAJOR_M = 6378137.0
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_SQUARED = _FLATTENING * (2.0 - _FLATTENING)
_HIGHEST_M = 1e6
# Distances from the centre of the Earth to its surface, with mountains; and from its equator's
# plane, below which map coordinates with a small height can have the same distance.
_SURFACE_M, _OFF_EQUATOR_M = (6.34e6, 6.4e6), 2e4
_ROUNDS = 8


@dataclass(frozen=True)
class Datum:
    """The origin of an east-north-up frame."""

    latitude_deg: float  # geodetic, from -90 to 90
    longitude_deg: float  # from -180 to 360
    height_m: float  # above the ellipsoid

    def __post_init__(self) -> None:
        if not (
            abs(self.latitude_deg) <= 90.0
            and -180.0 <= self.longitude_deg <= 360.0
            and abs(self.height_m) <= _HIGHEST_M
        ):
            raise SettingsError(
                f"the datum {self} is out of range; give a latitude from -90 to 90 deg, a "
                "longitude from -180 to 360 deg and a height in metres"
            )

    def __str__(self) -> str:
        return f"{self.latitude_deg!r},{self.longitude_deg!r},{self.height_m!r}"

    @property
    def coordinates(self) -> Floats:
        """Latitude and longitude in degrees, height in metres, (3,)."""
        return np.array([self.latitude_deg, self.longitude_deg, self.height_m])


def parse_datum(text: str) -> Datum:
    """Parse "47.4,8.5,430": latitude and longitude in degrees, height in metres."""
    try:
        latitude, longitude, height = (float(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(
            f"the datum {text!r} is not valid; give latitude and longitude in degrees and height "
            "in metres, as in --datum 47.4,8.5,430"
        ) from None
    return Datum(latitude, longitude, height)


def east_north_up(places: Floats, datum: Datum) -> Floats:
    """Return positions in the frame of a datum, with an error of 5e-9 m within 50 km.

    `places`: (N, 3), latitude and longitude in degrees, height above the ellipsoid in metres.
    `datum`: origin of the frame.

    Returns:
        (N, 3), east, north and up, metres.
    """
    origin = datum.coordinates
    moved: Floats = (_earth_fixed(places) - _earth_fixed(origin)) @ _axes(origin).T
    return moved


def is_earth_centred(positions: Floats) -> bool:
    """Return whether positions (N, 3), metres, are probably earth-centred (ECEF).

    Then no axis of their frame is vertical. Places within 20 km of the equator are not recognised.
    """
    least, most = _SURFACE_M
    for some in (positions[:1], positions):  # the first one decides most often
        distances = np.linalg.norm(some, axis=1)
        is_centred = (
            len(some)
            and np.all((least < distances) & (distances < most))
            and np.all(np.abs(some[:, 2]) > _OFF_EQUATOR_M)
        )
        if not is_centred:
            return False
    return True


def rotated_covariances(covariances: Floats, places: Floats, datum: Datum) -> Floats:
    """Return covariances (N, 3, 3) about the places' east, north and up in a datum's frame."""
    rotations = _axes(datum.coordinates) @ np.swapaxes(_axes(places), -1, -2)
    rotated: Floats = rotations @ covariances @ np.swapaxes(rotations, -1, -2)
    return rotated


def _earth_fixed(places: Floats) -> Floats:
    """Return places (..., 3) in the earth-centred, earth-fixed frame, metres."""
    latitude, longitude = np.radians(places[..., 0]), np.radians(places[..., 1])
    height, level = places[..., 2], np.cos(latitude)
    radius = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    return np.stack(
        [
            (radius + height) * level * np.cos(longitude),
            (radius + height) * level * np.sin(longitude),
            (radius * (1.0 - _ECCENTRICITY_SQUARED) + height) * np.sin(latitude),
        ],
        axis=-1,
    )


def _axes(places: Floats) -> Floats:
    """Return the axes east, north and up of the tangent frames as rows, (..., 3, 3)."""
    latitude, longitude = np.radians(places[..., 0]), np.radians(places[..., 1])
    sin_f, cos_f = np.sin(latitude), np.cos(latitude)
    sin_l, cos_l = np.sin(longitude), np.cos(longitude)
    east = np.stack([-sin_l, cos_l, np.zeros_like(sin_l)], axis=-1)
    north = np.stack([-sin_f * cos_l, -sin_f * sin_l, cos_f], axis=-1)
    up = np.stack([cos_f * cos_l, cos_f * sin_l, sin_f], axis=-1)
    return np.stack([east, north, up], axis=-2)


def places_at(positions: Floats, datum: Datum) -> Floats:
    """Return the places of positions in the frame of a datum: the inverse of `east_north_up`.

    `positions`: (N, 3), east, north and up, metres, within 100 km; not near a pole. `datum`:
    origin of the frame.

    Returns:
        (N, 3), latitude and longitude in degrees, height in metres, to a nanometre.
    """
    sine = np.sin(np.radians(datum.latitude_deg))
    level = 1.0 - _ECCENTRICITY_SQUARED * sine**2
    across = _SEMI_MAJOR_M / np.sqrt(level)
    along = across * (1.0 - _ECCENTRICITY_SQUARED) / level
    across *= np.cos(np.radians(datum.latitude_deg))
    per_metre = np.array([np.degrees(1.0 / along), np.degrees(1.0 / across), 1.0])
    places = np.tile(datum.coordinates, (len(positions), 1))
    # An iteration reduces the error by the factor distance / earth's radius.
    for _ in range(_ROUNDS):
        places += (positions - east_north_up(places, datum))[:, [1, 0, 2]] * per_metre
    return places
