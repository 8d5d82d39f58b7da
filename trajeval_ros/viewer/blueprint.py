"""The layout at first open: the paths at the left, the numbers at the right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.viewer import colours, scene_entities
from trajeval_ros.viewer.appearance import ROW, WIDTH, rows_of
from trajeval_ros.viewer.named_frames import frame_of
from trajeval_ros.viewer.paths import size_of
from trajeval_ros.viewer.scene_entities import TIMELINE
from trajeval_ros.viewer.sdk import sdk


def with_panels(views: Any) -> Any:
    """Return a layout of views, with the panels around them closed."""
    _, layout = sdk()
    return layout.Blueprint(
        views,
        layout.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        layout.SelectionPanel(state="collapsed"),
        layout.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def until_now(seconds: float | None = None) -> Any:
    """Return the times up to the cursor, all or the newest, for entities that grow."""
    _, layout = sdk()
    begin = (
        layout.TimeRangeBoundary.infinite()
        if seconds is None
        else layout.TimeRangeBoundary.cursor_relative(seconds=-seconds)
    )
    return layout.VisibleTimeRanges(
        [
            layout.VisibleTimeRange(
                TIMELINE, start=begin, end=layout.TimeRangeBoundary.cursor_relative()
            )
        ]
    )


def whole_run() -> Any:
    """Return the time axis of a plot: the whole run, not Rerun's default around the cursor."""
    rerun, layout = sdk()
    everything = rerun.TimeRange(
        start=layout.TimeRangeBoundary.infinite(), end=layout.TimeRangeBoundary.infinite()
    )
    return layout.TimeAxis(link="independent", view_range=everything)


_MOST_COLOURED = 1  # estimate coloured by error; several need a colour per estimate


def blueprint(
    estimates: Sequence[scene_entities.EstimateEntities],
    gauge: Gauge,
    *,
    is_live: bool,
    has_consistency: bool = False,
    has_available: bool = False,
    has_map: bool = False,
    bounds: tuple[Floats, Floats] | None = None,
    positions_m: Floats | None = None,
    rotations_deg: Floats | None = None,
) -> Any:
    """Return the layout.

    Args:
        bounds: Smallest and largest coordinates of all paths, (3,) and (3,).
        positions_m: Position errors of all estimates (N,), for the range of their plot.
        rotations_deg: Rotation errors of all estimates (N,), likewise; outliers are cut off.
    """
    _, layout = sdk()
    spaces = [
        _space(estimates, is_live=is_live, bounds=bounds, follows=follows)
        for follows in (False, True)
    ]
    # A legend of several estimates would cover the plot.
    tops = _top(positions_m, cuts=False), _top(rotations_deg, cuts=True)
    more = [_plot("Scale", scene_entities.SCALE)] if gauge.has_scale else []
    if is_live:
        more.append(_plot("Yaw of the alignment [deg]", scene_entities.ALIGNMENT_YAW))
    if has_available:
        more.append(_plot("Age of the received pose [s]", scene_entities.POSE_AGE))
    errors = _errors(more, estimates=len(estimates), tops=tops)
    return with_panels(
        layout.Horizontal(
            layout.Vertical(
                layout.Tabs(*spaces, *([_map()] if has_map else [])),
                _legend(len(estimates)),
                row_shares=[16, 1 + rows_of(len(estimates))],
            ),
            layout.Tabs(errors, _within_bands()) if has_consistency else errors,
            column_shares=[5, 3] if len(estimates) == 1 else [5, 4],
        )
    )


def _map() -> Any:
    """Return the map, in a hidden tab, since a viewer requests its tiles from OpenStreetMap."""
    _, layout = sdk()
    return layout.MapView(origin=f"/{scene_entities.MAP}", name="Map")


_OUTLIERS = 98.0  # percentile: a few large errors must not flatten a plot


# Rerun labels multiples of a power of ten, if they are far apart. From this share of the next
# power on, they are too close in a plot of a sixth of the window, and only 0 would have a label.
_UNLABELLED = 0.4


def _top(errors: Floats | None, *, cuts: bool) -> float | None:
    """Return the end of the axis of errors (N,); None for the choice of Rerun.

    `cuts`: whether a few large errors are beyond the end.
    """
    if errors is None or not errors.any():
        return None
    top = largest = float(errors.max())
    usual = 1.3 * float(np.percentile(errors, _OUTLIERS))
    if cuts and 0.0 < 1.5 * usual < largest:
        top = usual
    power = float(10.0 ** np.ceil(np.log10(top)))
    if top >= _UNLABELLED * power:
        return 1.04 * power
    return top if top < largest else None


def state_lanes(name: str) -> Any:
    """Return the view of states over time."""
    _, layout = sdk()
    contents = [f"/{lane}/**" for lane in scene_entities.LANES]
    return layout.StateTimelineView(
        origin="/", contents=contents, name=name, time_view=whole_run()
    )


def _errors(more: list[Any], *, estimates: int, tops: tuple[float | None, float | None]) -> Any:
    _, layout = sdk()
    return layout.Vertical(
        layout.TextDocumentView(origin=f"/{scene_entities.SUMMARY}", name="Summary"),
        _plot(
            "Position error and ATE (RMSE) [m]",
            scene_entities.POSITION_ERROR,
            scene_entities.ATE_POSITION,
            scene_entities.REVISED_ATE_POSITION,
            scene_entities.AVAILABLE_POSITION,
            top=tops[0],
        ),
        _plot(
            "Rotation error and RMSE [deg]",
            scene_entities.ROTATION_ERROR,
            scene_entities.ATE_ROTATION,
            top=tops[1],
        ),
        layout.Tabs(
            state_lanes("Status"),
            event_list("Events"),
            _plot("Relative error [m]", scene_entities.RELATIVE_ERROR, legend=estimates == 1),
            _plot("Yaw error [deg]", scene_entities.YAW_ERROR),
            *more,
        ),
        name="Errors",
        row_shares=[7, 4, 3, 3] if estimates == 1 else [6, 4, 3, 5],
    )


def _within_bands() -> Any:
    _, layout = sdk()
    names = ("x [m]", "y [m]", "z [m]", "φx [deg]", "φy [deg]", "φz [deg]")
    plots = [_plot(*item) for item in zip(names, scene_entities.ERRORS_WITHIN, strict=True)]
    return layout.Vertical(
        *(layout.Horizontal(plots[axis], plots[axis + 3]) for axis in range(3)),
        _plot("NEES of poses / dof", scene_entities.NEES, scene_entities.NEES_LIMIT, legend=True),
        name="Errors within 3 sigma",
    )


def _legend(estimates: int) -> Any:
    _, layout = sdk()
    return layout.Spatial2DView(
        origin=f"/{scene_entities.LEGEND}",
        name="Position error and legend",
        background=layout.Background(color=colours.BACKGROUND),
        visual_bounds=layout.VisualBounds2D(
            x_range=[-30.0, WIDTH], y_range=[-8.0, ROW * rows_of(estimates)]
        ),
    )


def _space(
    estimates: Sequence[scene_entities.EstimateEntities],
    *,
    is_live: bool,
    bounds: tuple[Floats, Floats] | None,
    follows: bool,
) -> Any:
    """Return the view of the paths: of the whole scene, or from behind the first estimate."""
    _, layout = sdk()
    # Live, only the latest rows are visible: their entities are drawn again as they grow.
    growing = [] if is_live else _drawn_once(estimates)
    overrides: dict[str, list[Any]] = {item: [until_now()] for item in growing}
    if is_live:
        overrides[estimates[0].points] = [until_now(_SCANS_S)]
    if len(estimates) > _MOST_COLOURED:
        hidden = [estimate.by_error for estimate in estimates]
    else:  # live, colours are drawn later than the path
        hidden = [] if is_live else [estimate.path.past for estimate in estimates]
    for item in hidden:
        overrides.setdefault(item, []).append(layout.EntityBehavior(visible=False))
    at = estimates[0].pose if follows else scene_entities.WORLD
    behind = layout.EyeControls3D(
        position=_BEHIND_M, look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
    )
    return layout.Spatial3DView(
        origin=f"/{at}",
        # Entities of other recordings are drawn, too. Named frames in them would otherwise change
        # the frame of the view.
        contents=["/**", *(f"- /{item}/**" for item in _FLAT)],
        spatial_information=layout.SpatialInformation(target_frame=frame_of(at)),
        name="Follow" if follows else "Groundtruth and aligned estimate",
        overrides=overrides,
        background=layout.Background(color=colours.BACKGROUND),
        line_grid=layout.LineGrid3D(
            visible=not follows, color=colours.GRID, spacing=_spacing(bounds)
        ),
        eye_controls=behind if follows else _eye(bounds, 1.0 if len(estimates) == 1 else 1.2),
    )


_SCANS_S = 60.0  # every visible scan takes time in every frame of the viewer
_BEHIND_M = (-6.0, 0.0, 3.0)  # in the frame of the body
_FLAT = (scene_entities.LEGEND, scene_entities.MAP, "metrics")


def _drawn_once(estimates: Sequence[scene_entities.EstimateEntities]) -> list[str]:
    """Return the entities of a recorded picture whose rows stay visible."""
    return [
        scene_entities.GroundtruthEntities.path.past,
        *(estimate.path.past for estimate in estimates),
        *(estimate.by_error for estimate in estimates),
        *(estimate.correspondences for estimate in estimates),
        *(estimate.uncertainty for estimate in estimates),
    ]


def event_list(name: str) -> Any:
    """Return the view of the log."""
    _, layout = sdk()
    columns = layout.TextLogColumns(
        timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
    )
    return layout.TextLogView(origin=f"/{scene_entities.EVENTS}", name=name, columns=columns)


def _plot(name: str, *quantities: str, legend: bool = False, top: float | None = None) -> Any:
    _, layout = sdk()
    return layout.TimeSeriesView(
        origin="/metrics",
        contents=[f"/metrics/{quantity}/**" for quantity in quantities],
        name=name,
        axis_x=whole_run(),
        axis_y=None if top is None else layout.ScalarAxis(range=(0.0, top)),
        plot_legend=layout.PlotLegend(layout.Corner2D.LeftTop, visible=legend),
    )


def _spacing(bounds: tuple[Floats, Floats] | None) -> float:
    """Return the grid spacing, a round number of about 1/20 of the picture's width."""
    if bounds is None:
        return 1.0
    rough = max(float((bounds[1] - bounds[0]).max()), 1e-3) / 20.0
    decade = 10.0 ** np.floor(np.log10(rough))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step * decade - rough)) * decade)


def _eye(bounds: tuple[Floats, Floats] | None, distance: float) -> Any:
    """Return the initial view from the south and above; the distance is in sizes of the scene."""
    if bounds is None:
        return None
    _, layout = sdk()
    low, high = bounds
    centre, size = (low + high) / 2.0, size_of(bounds)
    return layout.EyeControls3D(
        position=centre + distance * size * np.array([0.0, -0.52, 0.66]),
        look_target=centre,
        eye_up=(0.0, 0.0, 1.0),
    )
