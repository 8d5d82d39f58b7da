"""The picture of an examined groundtruth: its path, and the repaired one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.writing import write_whole
from trajeval_ros.viewer import colours, entity_data, scene_entities
from trajeval_ros.viewer.blueprint import event_list, until_now, whole_run, with_panels
from trajeval_ros.viewer.paths import origin_for
from trajeval_ros.viewer.recorded_scene import send_path, send_series
from trajeval_ros.viewer.recording_file import recording_writer
from trajeval_ros.viewer.sdk import sdk

if TYPE_CHECKING:
    from trajeval_ros.calibration.groundtruth_doctor.examine import ExaminedGroundtruth, Fits

_MOST_ROWS = 400
_PATHS = tuple(f"{scene_entities.WORLD}/{name}" for name in ("original", "repaired"))
_RESIDUALS = "groundtruth"


def write_groundtruth(
    path: Path, original: Trajectory, found: ExaminedGroundtruth, fits: Fits
) -> None:
    """Write a Rerun file (.rrd) of both trajectories, the residuals and the findings."""
    rerun, layout = sdk()

    def draw(recording: Any) -> None:
        origin = origin_for(original.positions)
        for place, (entity, each) in enumerate(
            zip(_PATHS, (original, fits.repaired), strict=True)
        ):
            look = entity_data.LineLook(colours.of_estimate(place), 1.0)
            declared = rerun.LineStrips3D.from_fields(**look.fields)
            recording.log(entity, declared, static=True)
            send_path(recording, entity, each, origin, _MOST_ROWS)
        first = int(original.stamps.min())
        stamps = first + (fits.short.seconds * NANOSECONDS).astype("int64")
        for column, name in enumerate(("position_m", "rotation_rad")):
            entity = f"{_RESIDUALS}/{name}"
            recording.log(entity, rerun.SeriesLines(names=[name]), static=True)
            send_series(recording, entity, stamps, fits.short.residuals[:, column])
        for cause in found.significant:
            event = entity_data.event(cause.sentence, warn=True)
            entity_data.log(recording, scene_entities.EVENTS, first, event)

    plots = layout.TimeSeriesView(
        origin=f"/{_RESIDUALS}", name="Residuals of the groundtruth", axis_x=whole_run()
    )
    space = layout.Spatial3DView(
        origin=f"/{scene_entities.WORLD}",
        name="Groundtruth, original and repaired",
        overrides={path: [until_now()] for path in _PATHS},
        background=layout.Background(color=colours.BACKGROUND),
    )
    blueprint = with_panels(
        layout.Horizontal(space, layout.Vertical(plots, event_list("Findings")))
    )
    write = recording_writer(original.name or "groundtruth", blueprint, draw)
    write_whole(path, write, follow_link=True)
