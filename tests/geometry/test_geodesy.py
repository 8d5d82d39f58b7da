"""Latitude, longitude and height to east, north and up, against arithmetic of fifty digits."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, getcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.geodesy import (
    Datum,
    east_north_up,
    parse_datum,
    places_at,
    rotated_covariances,
)

PROMISED_M = 5e-9
DATUMS = [
    (42.375812, -71.147394667, 7.3),
    (-33.9, 151.2, 40.0),
    (0.0, 0.0, 0.0),
    (78.2, 15.6, 100.0),
    (47.4, 179.9999, 500.0),
    (90.0, 0.0, 0.0),
    (-90.0, 12.0, 2800.0),
]
getcontext().prec = 50
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097")


def sine_and_cosine(degrees: float) -> tuple[Decimal, Decimal]:
    """Return both of an angle, by their series."""
    angle = Decimal(degrees) * PI / 180
    sums, term = [Decimal(0), Decimal(0)], Decimal(1)
    for power in range(80):
        sums[power % 2] += term if power % 4 < 2 else -term
        term = term * angle / (power + 1)
    return sums[1], sums[0]


def exact(place: np.ndarray, datum: Datum) -> list[float]:
    """Return a place in a datum's frame, computed with fifty digits."""
    flattening = 1 / Decimal("298.257223563")
    squared = flattening * (2 - flattening)

    def earth_fixed(latitude: float, longitude: float, height: float) -> list[Decimal]:
        (sin_f, cos_f), (sin_l, cos_l) = sine_and_cosine(latitude), sine_and_cosine(longitude)
        radius = Decimal(6378137) / (1 - squared * sin_f * sin_f).sqrt()
        level = (radius + Decimal(height)) * cos_f
        return [level * cos_l, level * sin_l, (radius * (1 - squared) + Decimal(height)) * sin_f]

    origin = (datum.latitude_deg, datum.longitude_deg, datum.height_m)
    pairs = zip(earth_fixed(*map(float, place)), earth_fixed(*origin), strict=True)
    x, y, z = (one - other for one, other in pairs)
    (sin_f, cos_f), (sin_l, cos_l) = sine_and_cosine(origin[0]), sine_and_cosine(origin[1])
    out = cos_l * x + sin_l * y
    return [
        float(item)
        for item in (cos_l * y - sin_l * x, cos_f * z - sin_f * out, sin_f * z + cos_f * out)
    ]


@pytest.mark.parametrize("origin", DATUMS)
def test_within_fifty_kilometres_of_any_datum(origin: tuple[float, float, float]) -> None:
    datum, random = Datum(*origin), np.random.default_rng(1)
    span = np.degrees(50e3 / 6.37e6) / 1.5
    places = np.array(origin) + random.uniform(-1.0, 1.0, (60, 3)) * [span, span, 500.0]
    places[:, 0] = np.clip(places[:, 0], -90.0, 90.0)
    places[:, 1] = (places[:, 1] + 180.0) % 360.0 - 180.0  # across the antimeridian
    expected = [exact(place, datum) for place in places]
    np.testing.assert_allclose(east_north_up(places, datum), expected, rtol=0, atol=PROMISED_M)


def test_the_antimeridian_is_nowhere() -> None:
    datum = Datum(47.4, 179.9999, 500.0)
    over = east_north_up(np.array([[47.4, -179.9999, 500.0]]), datum)[0]
    assert over[0] == pytest.approx(15.08, abs=0.02)  # east, 0.0002 deg
    assert abs(over[1]) < 1e-4


def test_reference_vectors(reference: Callable[[str], Any]) -> None:
    assert len(reference("gnss")["geodesy"]["vectors"]) > 0
    for vector in reference("gnss")["geodesy"]["vectors"]:
        result = east_north_up(np.array([vector["lat_lon_h"]]), Datum(*vector["datum"]))
        np.testing.assert_allclose(result[0], vector["enu_m"], rtol=0, atol=PROMISED_M)


@given(
    latitude=st.floats(-89.0, 89.0),
    longitude=st.floats(-180.0, 180.0),
    north=st.floats(-0.2, 0.2),
    east=st.floats(-0.2, 0.2),
)
def test_the_frame_is_rigid(latitude: float, longitude: float, north: float, east: float) -> None:
    places = np.array([[latitude, longitude, 10.0], [latitude + north, longitude + east, 60.0]])
    lengths = []
    for datum in (Datum(latitude, longitude, 0.0), Datum(latitude + 0.1, longitude, 5.0)):
        first, second = east_north_up(places, datum)
        lengths.append(np.linalg.norm(second - first))
    assert lengths[0] == pytest.approx(lengths[1], abs=2 * PROMISED_M)


def test_covariances_turn_with_the_frame() -> None:
    datum = Datum(47.0, 8.0, 400.0)
    sigma = np.diag([1.0, 4.0, 9.0])[None]
    at_datum = rotated_covariances(sigma, datum.coordinates[None], datum)
    np.testing.assert_allclose(at_datum, sigma, atol=1e-12)
    # A quarter of the way around the earth, on the equator: east there is down here.
    around = rotated_covariances(sigma, np.array([[0.0, 90.0, 0.0]]), Datum(0.0, 0.0, 0.0))
    np.testing.assert_allclose(around[0], np.diag([9.0, 4.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize("text", ["47.4,8.5", "a,b,c", "91,0,0", "0,400,0", "0,0,nan", "0,0,1e9"])
def test_what_is_no_datum(text: str) -> None:
    with pytest.raises(SettingsError, match="latitude"):
        parse_datum(text)


def test_a_datum_is_written_to_the_last_digit() -> None:
    datum = Datum(42.375812, -71.14739466666667, 7.299999999999997)
    assert parse_datum(str(datum)) == datum


@pytest.mark.parametrize("origin", DATUMS[:5])
def test_places_are_found_again(origin: tuple[float, float, float]) -> None:
    datum = Datum(*origin)
    positions = np.random.default_rng(2).uniform(-30e3, 30e3, (50, 3)) * [1.0, 1.0, 0.01]
    again = east_north_up(places_at(positions, datum), datum)
    np.testing.assert_allclose(again, positions, rtol=0, atol=PROMISED_M)
