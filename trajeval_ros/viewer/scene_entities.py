"""What is drawn: the entities of the picture, live and recorded, and how each looks.

    world/groundtruth/path/{past,recent,newest}   where the body was, in the groundtruth's frame
    world/groundtruth/start                       where it began
    world/groundtruth/pose                        where it is
    world/estimate/NAME                           the alignment: moves everything below it
    world/estimate/NAME/path/{past,recent,newest} where it was estimated to be, in its own frame
    world/estimate/NAME/by_error                  the same path, coloured by position error
    world/estimate/NAME/revised                   the newest `nav_msgs/Path`, where that is one
    world/estimate/NAME/pose                      where it is estimated to be
    world/estimate/NAME/covariance                three sigma of its position
    world/uncertainty/NAME                        that of its error, in the alignment's gauge
    world/correspondences/NAME                    lines between poses of the same time
    metrics/QUANTITY/NAME...                      errors over time
    summary, events                               in words

A path that grows is drawn in few rows, since each costs the viewer 20 us per frame: whole pieces
of it are `past`, visible over all time; what has come since is `recent` and `newest`, of which the
latest counts. Raw positions are logged once: a new alignment is one small row, and moves them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.viewer import colours
from trajeval_ros.viewer.paths import pieces
from trajeval_ros.viewer.sdk import sdk

APPLICATION = "trajeval"
TIMELINE = "ros_time"
WORLD = "world"
SUMMARY, EVENTS = "summary", "events"
_AXES_M = 0.4
_DOT = 5.0
SIGMAS = 3.0

# Of metrics: the names are those of the node's topics.
POSITION_ERROR, ROTATION_ERROR = "position_error", "rotation_error"
ATE_POSITION, ATE_ROTATION = "ate_position", "ate_rotation"
YAW_ERROR, SCALE, RELATIVE_ERROR = "yaw_error", "scale", "relative_error"
REVISED_ATE_POSITION, ALIGNMENT_YAW = "revised_ate_position", "alignment_yaw"
# Of each axis: the error, and three sigma above and below zero; metres, degrees.
ERRORS_WITHIN = tuple(f"error_{axis}" for axis in ("x", "y", "z", "phi_x", "phi_y", "phi_z"))
NEES, NEES_LIMIT = "nees", "nees_limit"


@dataclass(frozen=True)
class PathEntities:
    """The three parts of a path that grows."""

    past: str
    recent: str
    newest: str

    @classmethod
    def below(cls, entity: str) -> PathEntities:
        """Return the parts of the path of an entity."""
        return cls(*(f"{entity}/path/{each}" for each in ("past", "recent", "newest")))


class GroundtruthEntities:
    """Where the groundtruth is drawn."""

    path = PathEntities.below(f"{WORLD}/groundtruth")
    start = f"{WORLD}/groundtruth/start"
    pose = f"{WORLD}/groundtruth/pose"


class EstimateEntities:
    """Where one estimate is drawn.

    Attributes:
        name: What it is called.
        colour: Of its lines.
    """

    def __init__(self, name: str, place: int) -> None:
        """Give the estimate at a place in the list its entities."""
        rerun, _ = sdk()
        self.name, self.colour = name, colours.of_estimate(place)
        self._part = rerun.escape_entity_path_part(name)
        self.frame = f"{WORLD}/estimate/{self._part}"
        self.path = PathEntities.below(self.frame)
        self.by_error = f"{self.frame}/by_error"
        self.revised = f"{self.frame}/revised"
        self.pose = f"{self.frame}/pose"
        self.covariance = f"{self.frame}/covariance"
        self.uncertainty = f"{WORLD}/uncertainty/{self._part}"
        self.correspondences = f"{WORLD}/correspondences/{self._part}"

    def metric(self, quantity: str, part: str = "") -> str:
        """Return where a quantity is plotted."""
        return f"metrics/{quantity}/{self._part}" + (f"/{part}" if part else "")


def declare(recording: Any, estimates: Sequence[EstimateEntities]) -> None:
    """Log once how everything looks."""
    rerun, _ = sdk()
    recording.log(WORLD, rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _declare_path(recording, GroundtruthEntities.path, colours.GROUNDTRUTH, 1.2)
    _declare_pose(recording, GroundtruthEntities.pose, colours.GROUNDTRUTH)
    for each in estimates:
        _declare_path(recording, each.path, each.colour, 1.0 if len(estimates) == 1 else 1.6)
        _declare_pose(recording, each.pose, each.colour, each.name)
        recording.log(each.pose, rerun.TransformAxes3D(_AXES_M), static=True)
        _declare_lines(recording, each.by_error, None, 2.6)
        _declare_lines(recording, each.revised, each.colour, 1.0)
        _declare_lines(recording, each.correspondences, None, 0.8)
        _declare_ellipsoids(recording, each.covariance, each.colour)
        _declare_series(recording, each)


def declare_length(recording: Any, estimate: EstimateEntities, length: str, place: int) -> None:
    """Log once how the relative error of a length looks: the longer, the brighter."""
    shade = 0.45 + 0.55 * min(place, 4) / 4.0
    colour = tuple(round(shade * each) for each in estimate.colour)
    _series(
        recording, estimate.metric(RELATIVE_ERROR, length), f"{estimate.name} {length}", colour
    )


def declare_consistency(recording: Any, estimate: EstimateEntities) -> None:
    """Log once how errors beside their uncertainty look."""
    rerun, _ = sdk()
    name, colour = estimate.name, estimate.colour
    _declare_ellipsoids(recording, estimate.uncertainty, colour)
    _series(recording, estimate.metric(NEES), name, colour)
    label = f"{name}, 95 % of honest runs stay below"
    _series(recording, estimate.metric(NEES_LIMIT), label, colours.BAND, 1.6)
    for quantity in ERRORS_WITHIN:
        bands = rerun.SeriesLines(
            colors=[colour, colours.BAND, colours.BAND],
            names=[name, f"{SIGMAS:g} sigma", f"-{SIGMAS:g} sigma"],
            widths=[1.2, 1.6, 1.6],
        )
        recording.log(estimate.metric(quantity), bands, static=True)


def _declare_ellipsoids(recording: Any, entity: str, colour: colours.Colour) -> None:
    rerun, _ = sdk()
    ellipsoids = rerun.Ellipsoids3D.from_fields(
        colors=[(*colour, 110)], fill_mode=rerun.components.FillMode.Solid
    )
    recording.log(entity, ellipsoids, static=True)


def _declare_path(
    recording: Any, path: PathEntities, colour: colours.Colour, radius: float
) -> None:
    for each in (path.past, path.recent, path.newest):
        _declare_lines(recording, each, colour, radius)


def _declare_lines(
    recording: Any, entity: str, colour: colours.Colour | None, radius: float
) -> None:
    rerun, _ = sdk()
    recording.log(
        entity,
        rerun.LineStrips3D.from_fields(
            colors=None if colour is None else [colour],
            radii=[rerun.Radius.ui_points(radius)],
        ),
        static=True,
    )


def _declare_pose(recording: Any, entity: str, colour: colours.Colour, label: str = "") -> None:
    recording.log(entity, marker(np.zeros(3), colour, label), static=True)


def _declare_series(recording: Any, estimate: EstimateEntities) -> None:
    name, colour = estimate.name, estimate.colour
    pale = tuple((each + 255) // 2 for each in colour)
    for quantity, label, its, width in (
        (POSITION_ERROR, name, colour, 1.2),
        (ATE_POSITION, f"{name}, ATE (rmse)", pale, 2.4),
        (REVISED_ATE_POSITION, f"{name}, ATE of the revised path", pale, 1.2),
        (ROTATION_ERROR, name, colour, 1.2),
        (ATE_ROTATION, f"{name}, ATE (rmse)", pale, 2.4),
        (YAW_ERROR, f"{name}, yaw", colour, 1.2),
        (SCALE, f"{name}, scale", colour, 1.6),
        (ALIGNMENT_YAW, f"{name}, yaw of the alignment", colour, 1.6),
    ):
        _series(recording, estimate.metric(quantity), label, its, width)


def _series(recording: Any, entity: str, label: str, colour: Any, width: float = 1.2) -> None:
    rerun, _ = sdk()
    style = rerun.SeriesLines(colors=[colour], names=[label], widths=[width])
    recording.log(entity, style, static=True)


def send_origin(recording: Any, origin: Floats) -> None:
    """Log where the picture's origin is in the groundtruth's frame, (3,), metres."""
    rerun, _ = sdk()
    recording.send_property("origin", rerun.AnyValues(groundtruth_m=origin))


def origin_in_words(origin: Floats) -> str:
    """Say the same."""
    return "coordinates are drawn from (" + ", ".join(f"{each:.0f}" for each in origin) + ") m"


# The data of each kind of entity.


def times(stamps: NDArray[np.int64]) -> list[Any]:
    """Return the stamps (N,) of rows that are sent as columns."""
    rerun, _ = sdk()
    return [rerun.TimeColumn(TIMELINE, timestamp=stamps.astype("datetime64[ns]"))]


def lines(strips: Sequence[Floats] | Floats) -> Any:
    """Return lines through points, each (N, 3)."""
    rerun, _ = sdk()
    return rerun.LineStrips3D.from_fields(strips=strips)


def marker(position: Floats, colour: colours.Colour, label: str = "") -> Any:
    """Return a dot at a position (3,), with a name."""
    rerun, _ = sdk()
    return rerun.Points3D(
        [position],
        colors=[colour],
        radii=[rerun.Radius.ui_points(_DOT)],
        labels=[label] if label else None,
        show_labels=bool(label),
    )


def start(position: Floats) -> Any:
    """Return where the groundtruth began, (3,)."""
    return marker(position, colours.GROUNDTRUTH, "groundtruth starts here")


def path_by_error(
    points: Floats, errors: Floats, is_gap: Booleans, full_m: float, most: int
) -> Any:
    """Return a path (N, 3) coloured by errors (N,), in so many pieces at the most."""
    rerun, _ = sdk()
    rows = pieces(len(points), is_gap, most)
    return rerun.LineStrips3D.from_fields(
        strips=points[rows].astype(np.float32),
        colors=colours.of_errors(errors[rows].mean(axis=1), full_m),
    )


def correspondences(truth: Floats, aligned: Floats, full_m: float) -> Any:
    """Return lines between positions (N, 3) and (N, 3), coloured by their lengths."""
    rerun, _ = sdk()
    errors = np.sqrt(np.square(truth - aligned).sum(axis=1))
    return rerun.LineStrips3D.from_fields(
        strips=np.stack([truth, aligned], axis=1).astype(np.float32),
        colors=colours.of_errors(errors, full_m),
    )


def alignment(similarity: Similarity) -> Any:
    """Return what moves an estimate into the groundtruth's frame, its scale included."""
    rerun, _ = sdk()
    return rerun.Transform3D(
        translation=similarity.translation,
        mat3x3=similarity.rotation,
        scale=similarity.scale,
    )


def pose(position: Floats, quaternion: Floats) -> Any:
    """Return a pose: (3,), and (4,) xyzw or NaN."""
    rerun, _ = sdk()
    if np.isnan(quaternion).any():
        return rerun.Transform3D(translation=position)
    return rerun.Transform3D(translation=position, quaternion=rerun.Quaternion(xyzw=quaternion))


def ellipsoid_axes(covariances: Floats) -> tuple[Floats, Floats]:
    """Return half axes (N, 3), metres, and directions (N, 3, 3) of three sigma of (N, 3, 3)."""
    variances, directions = np.linalg.eigh(covariances)
    # A mirrored basis is no rotation.
    directions[:, :, 0] *= np.sign(np.linalg.det(directions))[:, None]
    return SIGMAS * np.sqrt(np.maximum(variances, 0.0)), directions


def ellipsoid(position: Floats, covariance: Floats) -> Any:
    """Return three sigma of a covariance (3, 3) about a position (3,)."""
    rerun, _ = sdk()
    half_axes, directions = ellipsoid_axes(covariance[None])
    return rerun.Ellipsoids3D.from_fields(
        centers=[position],
        half_sizes=half_axes,
        quaternions=Rotation.from_matrix(directions).as_quat(),
    )


def number(value: float) -> Any:
    """Return a value of a series."""
    rerun, _ = sdk()
    return rerun.Scalars(value)


def event(text: str, *, warn: bool) -> Any:
    """Return a line of the log."""
    rerun, _ = sdk()
    level = rerun.TextLogLevel.WARN if warn else rerun.TextLogLevel.INFO
    return rerun.TextLog(text, level=level)


def summary(markdown: str) -> Any:
    """Return a text in Markdown."""
    rerun, _ = sdk()
    return rerun.TextDocument(markdown, media_type=rerun.MediaType.MARKDOWN)
