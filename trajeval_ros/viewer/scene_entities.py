"""What is drawn: the entities of the picture, live and recorded.

    world/groundtruth/path/{past,recent,newest}   where the body was, in the groundtruth's frame
    world/groundtruth/start                       where it started
    world/groundtruth/pose                        where it is
    world/estimate/NAME                           the alignment: moves everything below it
    world/estimate/NAME/path/{past,recent,newest} where it was estimated to be, in its own frame
    world/estimate/NAME/by_error                  the same path, coloured by position error
    world/estimate/NAME/pose                      where it is estimated to be
    world/estimate/NAME/covariance                three sigma of its position
    world/uncertainty/NAME                        that of its error, in the alignment's gauge
    world/correspondences/NAME                    lines between poses of the same time
    metrics/QUANTITY/NAME...                      errors over time
    summary, events                               in words
    legend/{ramp,scale,names}                     what colours stand for
    map/fixes, map/estimate/NAME                  latitude and longitude, of GNSS fixes

How each looks is in `appearance`, what is logged of it in `entity_data`.

A path that grows is drawn in few rows, since each costs the viewer 20 us per frame: whole pieces
of it are `past`, visible over all time; what has come since is `recent` and `newest`, of which the
latest counts. Raw positions are logged once: a new alignment is one small row, and moves them all.
"""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.viewer import colours
from trajeval_ros.viewer.sdk import sdk

APPLICATION = "trajeval"
TIMELINE = "ros_time"
WORLD = "world"
SUMMARY, EVENTS, LEGEND = "summary", "events", "legend"
MAP = "map"
MAP_FIXES = f"{MAP}/fixes"
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
        name: What it is called, as it can be shown.
        colour: Of its lines.
    """

    def __init__(self, name: str, place: int) -> None:
        """Give the estimate at a place in the list its entities."""
        rerun, _ = sdk()
        self.name, self.colour = one_line(name), colours.of_estimate(place)
        self._part = rerun.escape_entity_path_part(self.name)
        self.frame = f"{WORLD}/estimate/{self._part}"
        self.path = PathEntities.below(self.frame)
        self.by_error = f"{self.frame}/by_error"
        self.pose = f"{self.frame}/pose"
        self.covariance = f"{self.frame}/covariance"
        self.on_map = f"{MAP}/estimate/{self._part}"
        self.uncertainty = f"{WORLD}/uncertainty/{self._part}"
        self.correspondences = f"{WORLD}/correspondences/{self._part}"

    def metric(self, quantity: str, part: str = "") -> str:
        """Return where a quantity is plotted."""
        return f"metrics/{quantity}/{self._part}" + (f"/{part}" if part else "")
