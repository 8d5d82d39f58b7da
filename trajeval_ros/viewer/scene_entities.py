"""The entities of the picture, live and recorded.

    world/groundtruth/path/{past,recent,newest}   path of the body, in the groundtruth's frame;
                                                  live, the past is past/0, past/1, ...
    world/groundtruth/start                       its first position
    world/groundtruth/pose                        its newest pose
    world/estimate/NAME                           the alignment: transforms all entities below it
    world/estimate/NAME/path/{past,recent,newest} estimated path, in the estimate's frame
    world/estimate/NAME/by_error                  the same path, coloured by position error
    world/estimate/NAME/pose                      newest estimated pose
    world/estimate/NAME/points                    scans, live; those of the newest 60 s are visible
    world/estimate/NAME/covariance                three standard deviations of its position
    world/uncertainty/NAME                        the same of its error, in the alignment's gauge
    world/correspondences/NAME                    errors as lines from the groundtruth
    metrics/QUANTITY/NAME...                      errors over time
    status/NAME, alarm/NAME/QUANTITY              states over time
    tracking/NAME, gnss/fixes
    frames/FRAME                                  ROS frames, attached to entities of the world
    summary, events                               texts
    legend/{colours,scale}                        legend of the colours
    map/fixes, map/estimate/NAME                  latitude and longitude, with GNSS fixes

`appearance` defines the styles, `entity_data` the logged data.

A growing path is drawn in few rows, because the viewer needs 20 us per row and frame. Complete
pieces are `past`: in a recorded picture visible over all time, live on levels (`live_path`). Later
poses are in `recent` and `newest`. Positions are logged without alignment. A new alignment is one
small row and moves the whole path.
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
FRAMES = "frames"
STATUS, ALARM, TRACKING = "status", "alarm", "tracking"
FIX_STATUS = "gnss/fixes"
LANES = (STATUS, ALARM, TRACKING, FIX_STATUS)
SIGMAS = 3.0
_LEVELS = 5

# Quantities, with the names of the node's topics.
POSITION_ERROR, ROTATION_ERROR = "position_error", "rotation_error"
ATE_POSITION, ATE_ROTATION = "ate_position", "ate_rotation"
YAW_ERROR, SCALE, RELATIVE_ERROR = "yaw_error", "scale", "relative_error"
REVISED_ATE_POSITION, ALIGNMENT_YAW = "revised_ate_position", "alignment_yaw"
AVAILABLE_POSITION, POSE_AGE = "available/position", "available/age"
# Per axis: the error, and three standard deviations above and below zero; metres, degrees.
ERRORS_WITHIN = tuple(f"error_{axis}" for axis in ("x", "y", "z", "phi_x", "phi_y", "phi_z"))
NEES, NEES_LIMIT = "nees", "nees_limit"


@dataclass(frozen=True)
class PathEntities:
    """The three parts of a path that grows."""

    past: str
    recent: str
    newest: str

    @property
    def levels(self) -> tuple[str, ...]:
        """The levels of the past of a live path."""
        return tuple(f"{self.past}/{level}" for level in range(_LEVELS))

    @classmethod
    def below(cls, entity: str) -> PathEntities:
        """Return the parts of the path of an entity."""
        return cls(*(f"{entity}/path/{name}" for name in ("past", "recent", "newest")))


class GroundtruthEntities:
    """The entities of the groundtruth."""

    path = PathEntities.below(f"{WORLD}/groundtruth")
    start = f"{WORLD}/groundtruth/start"
    pose = f"{WORLD}/groundtruth/pose"


def lane(kind: str, *parts: str) -> str:
    """Return the entity of states over time, of a kind of `LANES`."""
    rerun, _ = sdk()
    return "/".join([kind, *map(rerun.escape_entity_path_part, parts)])


class EstimateEntities:
    """The entities of one estimate."""

    def __init__(self, name: str, place: int) -> None:
        rerun, _ = sdk()
        self.name, self.colour = one_line(name), colours.of_estimate(place)
        self._part = rerun.escape_entity_path_part(self.name)
        self.frame = f"{WORLD}/estimate/{self._part}"
        self.path = PathEntities.below(self.frame)
        self.by_error = f"{self.frame}/by_error"
        self.pose = f"{self.frame}/pose"
        self.points = f"{self.frame}/points"
        self.covariance = f"{self.frame}/covariance"
        self.on_map = f"{MAP}/estimate/{self._part}"
        self.uncertainty = f"{WORLD}/uncertainty/{self._part}"
        self.correspondences = f"{WORLD}/correspondences/{self._part}"
        self.tracking = lane(TRACKING, self.name)

    def metric(self, quantity: str, part: str = "") -> str:
        """Return the entity of a quantity."""
        return f"metrics/{quantity}/{self._part}" + (f"/{part}" if part else "")
