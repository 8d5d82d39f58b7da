"""The picture of an examined groundtruth: its path, and the repaired one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.writing import write_whole
from trajeval_ros.viewer import colours, entity_data, scene_entities
from trajeval_ros.viewer.blueprint import event_list, whole_run, with_panels
from trajeval_ros.viewer.paths import gaps, origin_for, peaks, pieces, spread
from trajeval_ros.viewer.recording_file import recording_writer
from trajeval_ros.viewer.sdk import sdk

if TYPE_CHECKING:
    from trajeval_ros.calibration.groundtruth_doctor.examine import ExaminedGroundtruth, Fits

_MOST_POINTS, _MOST_ROWS, _MOST_NUMBERS = 50_000, 2000, 20_000
_RESIDUALS = "groundtruth"


def write_groundtruth(
    path: Path, original: Trajectory, found: ExaminedGroundtruth, fits: Fits
) -> None:
    """Write a Rerun file (.rrd) of both trajectories, the residuals and the findings."""
    rerun, layout = sdk()

    def draw(recording: Any) -> None:
        origin = origin_for(original.positions)
        looks = zip(("original", "repaired"), (original, fits.repaired), strict=True)
        for place, (name, each) in enumerate(looks):
            look = entity_data.LineLook(colours.of_estimate(place), 1.0)
            _draw_path(recording, f"{scene_entities.WORLD}/{name}", each, origin, look)
        first = int(original.stamps.min())
        stamps = first + (fits.short.seconds * NANOSECONDS).astype("int64")
        for column, name in enumerate(("position_m", "rotation_rad")):
            values = fits.short.residuals[:, column]
            some = peaks(values, _MOST_NUMBERS)
            entity = f"{_RESIDUALS}/{name}"
            recording.log(entity, rerun.SeriesLines(names=[name]), static=True)
            entity_data.numbers(values[some]).send(recording, entity, stamps[some])
        for cause in found.significant:
            event = entity_data.event(cause.sentence, warn=True)
            entity_data.log(recording, scene_entities.EVENTS, first, event)

    plots = layout.TimeSeriesView(
        origin=f"/{_RESIDUALS}", name="Residuals of the groundtruth", axis_x=whole_run()
    )
    space = layout.Spatial3DView(
        origin=f"/{scene_entities.WORLD}",
        name="Groundtruth, original and repaired",
        background=layout.Background(color=colours.BACKGROUND),
    )
    blueprint = with_panels(
        layout.Horizontal(space, layout.Vertical(plots, event_list("Findings")))
    )
    write = recording_writer(original.name or "groundtruth", blueprint, draw)
    write_whole(path, write, follow_link=True)


def _draw_path(
    recording: Any, entity: str, each: Trajectory, origin: Floats, look: entity_data.LineLook
) -> None:
    some = spread(len(each), _MOST_POINTS)
    stamps, points = each.stamps[some], each.positions[some] - origin
    rows = pieces(len(some), gaps(stamps), _MOST_ROWS)
    for row in rows:
        lines = entity_data.lines([points[row]], look)
        entity_data.log(recording, entity, int(stamps[row[-1]]), lines.row())
