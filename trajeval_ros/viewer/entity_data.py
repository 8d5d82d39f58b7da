"""Data of all entities: rows for the live scene, columns for the recorded scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.viewer import colours
from trajeval_ros.viewer.scene_entities import SIGMAS, TIMELINE
from trajeval_ros.viewer.sdk import sdk

_DOT = 3.5  # points of the screen, at any distance
_YEAR_NS = 365 * 86_400 * 10**9


@dataclass(frozen=True)
class EntityData:
    """Elements of one kind."""

    archetype: Any  # the kind, a class of rerun-sdk
    fields: dict[str, Any]  # values of the N elements, by name of the argument

    def row(self) -> Any:
        """Return all elements as one row, for `log`."""
        return self.archetype.from_fields(**self.fields)

    def send(
        self, recording: Any, entity: str, stamps: Stamps, lengths: Indices | None = None
    ) -> None:
        """Log a row per timestamp (M,), with one element or with `lengths` (M,) elements."""
        rerun, _ = sdk()
        columns = self.archetype.columns(**self.fields)
        times = rerun.TimeColumn(TIMELINE, **_time_of(stamps))
        recording.send_columns(
            entity, [times], columns if lengths is None else columns.partition(lengths)
        )


def log(recording: Any, entity: str, stamp: int, row: Any) -> None:
    """Log one row at a timestamp."""
    recording.set_time(TIMELINE, **_time_of(np.int64(stamp)))
    recording.log(entity, row)


def _time_of(stamps: Stamps | np.int64) -> dict[str, Any]:
    """Return dates for Rerun, or durations on a clock that starts at 0, as of a simulator."""
    if np.any(stamps < _YEAR_NS):
        return {"duration": stamps.astype("timedelta64[ns]")}
    return {"timestamp": stamps.astype("datetime64[ns]")}


@dataclass(frozen=True)
class LineLook:
    """The look of lines."""

    colour: colours.Colour  # their colour
    radius: float  # half of their width, in points of the screen

    @property
    def fields(self) -> dict[str, Any]:
        """Arguments of Rerun's lines."""
        rerun, _ = sdk()
        return {"colors": [self.colour], "radii": [rerun.Radius.ui_points(self.radius)]}


def lines(strips: Sequence[Floats] | Floats, look: LineLook | None = None) -> EntityData:
    """Return lines through points, each (P, 3), with their look unless it is declared."""
    rerun, _ = sdk()
    fields = {} if look is None else look.fields
    return EntityData(rerun.LineStrips3D, {"strips": strips, **fields})


def path_by_error(points: Floats, errors: Floats, rows: Indices, full_m: float) -> EntityData:
    """Return pieces (M, P) of a path (N, 3), by index, coloured by errors (N,)."""
    rerun, _ = sdk()
    colors = colours.of_errors(errors[rows].mean(axis=1), full_m)
    return EntityData(rerun.LineStrips3D, {"strips": _narrow(points[rows]), "colors": colors})


def points(places: Floats) -> EntityData:
    """Return points (N, 3)."""
    rerun, _ = sdk()
    return EntityData(rerun.Points3D, {"positions": _narrow(places)})


def correspondences(
    groundtruth: Floats, aligned: Floats, full_m: float, factor: float
) -> EntityData:
    """Return errors as lines from (N, 3) to (N, 3), enlarged by a factor, coloured by length."""
    rerun, _ = sdk()
    errors = np.sqrt(np.square(groundtruth - aligned).sum(axis=1))
    ends = groundtruth + factor * (aligned - groundtruth)
    strips, colors = np.stack([groundtruth, ends], axis=1), colours.of_errors(errors, full_m)
    return EntityData(rerun.LineStrips3D, {"strips": _narrow(strips), "colors": colors})


def poses(positions: Floats, quaternions: Floats | None) -> EntityData:
    """Return poses (N, 3) and (N, 4) xyzw; without rotations if one is NaN."""
    rerun, _ = sdk()
    fields = {"translation": positions}
    if quaternions is not None and not np.isnan(quaternions).any():
        fields["quaternion"] = quaternions
    return EntityData(rerun.Transform3D, fields)


def ellipsoids(centres: Floats, covariances: Floats, factor: float = 1.0) -> EntityData:
    """Return ellipsoids of three standard deviations at (N, 3), enlarged by a factor."""
    rerun, _ = sdk()
    half_axes, directions = ellipsoid_axes(covariances)
    fields = {
        "centers": centres,
        "half_sizes": factor * half_axes,
        "quaternions": Rotation.from_matrix(directions).as_quat(),
    }
    return EntityData(rerun.Ellipsoids3D, fields)


def ellipsoid_axes(covariances: Floats) -> tuple[Floats, Floats]:
    """Return the ellipsoids of three standard deviations of covariances (N, 3, 3), m^2.

    Returns:
        Half axes (N, 3), metres, and rotation matrices (N, 3, 3) with the axes as columns.
    """
    variances, directions = np.linalg.eigh(covariances)
    # The determinant of a rotation is 1.
    directions[:, :, 0] *= np.sign(np.linalg.det(directions))[:, None]
    return SIGMAS * np.sqrt(np.maximum(variances, 0.0)), directions


def fixes_on_map(places: Floats, status: Indices) -> EntityData:
    """Return GNSS fixes at latitudes and longitudes (N, 2), degrees, coloured by status (N,)."""
    rerun, _ = sdk()
    colors = [colours.of_fix(item) for item in status.tolist()]
    return EntityData(rerun.GeoPoints, {"positions": places, "colors": colors})


def lines_on_map(strips: Sequence[Floats]) -> EntityData:
    """Return lines through latitudes and longitudes, each (P, 2), degrees."""
    rerun, _ = sdk()
    return EntityData(rerun.GeoLineStrings, {"line_strings": strips})


def numbers(values: Sequence[float] | Floats) -> EntityData:
    """Return values (N,) of a series."""
    rerun, _ = sdk()
    return EntityData(rerun.Scalars, {"scalars": values})


# Entities with a single element.


def alignment(similarity: Similarity) -> Any:
    """Return the alignment of an estimate with the groundtruth's frame, including its scale."""
    rerun, _ = sdk()
    return rerun.Transform3D(
        translation=similarity.translation, mat3x3=similarity.rotation, scale=similarity.scale
    )


def marker(position: Floats, colour: colours.Colour) -> Any:
    """Return a dot at a position (3,); its size does not depend on the distance."""
    rerun, _ = sdk()
    return rerun.Points3D([position], colors=[colour], radii=[rerun.Radius.ui_points(_DOT)])


def pose_axes(length_m: float) -> Any:
    """Return the axes of a pose with a length, metres."""
    rerun, _ = sdk()
    return rerun.TransformAxes3D(length_m)


def event(text: str, *, warn: bool) -> Any:
    """Return a line of the log."""
    rerun, _ = sdk()
    level = rerun.TextLogLevel.WARN if warn else rerun.TextLogLevel.INFO
    return rerun.TextLog(one_line(text), level=level)


def summary(markdown: str) -> Any:
    """Return a text in Markdown."""
    rerun, _ = sdk()
    return rerun.TextDocument(markdown, media_type=rerun.MediaType.MARKDOWN)


def send_origin(recording: Any, origin: Floats) -> None:
    """Log the picture's origin in the groundtruth's frame, (3,), metres."""
    rerun, _ = sdk()
    recording.send_property("origin", rerun.AnyValues(groundtruth_m=origin))


def _narrow(points: Floats) -> Any:
    """Return coordinates in Rerun's type, which avoids a conversion per value."""
    return points.astype(np.float32)
