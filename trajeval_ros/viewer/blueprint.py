"""The layout at first open: the paths at the left, the numbers at the right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.viewer import colours, scene_entities
from trajeval_ros.viewer.layout_parts import until_now, whole_run, with_panels
from trajeval_ros.viewer.legend import ROW, WIDTH, rows_of
from trajeval_ros.viewer.sdk import sdk

_MOST_COLOURED = 1  # estimate coloured by error; several need a colour per estimate


def blueprint(
    estimates: Sequence[scene_entities.EstimateEntities],
    gauge: Gauge,
    *,
    is_live: bool,
    has_consistency: bool = False,
    has_map: bool = False,
    bounds: tuple[Floats, Floats] | None = None,
) -> Any:
    """Return the layout.

    Args:
        estimates: Entities of the estimates.
        gauge: Gauge of the alignments.
        is_live: Whether data arrive while the viewer is open.
        has_consistency: Whether errors are drawn with bands of three standard deviations.
        has_map: Whether latitudes and longitudes are known.
        bounds: Smallest and largest coordinates (3,), (3,) of all paths, if known.
    """
    _, layout = sdk()
    # A legend of several estimates would cover the plot.
    space = _space(estimates, is_live=is_live, bounds=bounds)
    errors = _errors(gauge, is_live=is_live, legend=len(estimates) == 1)
    return with_panels(
        layout.Horizontal(
            layout.Vertical(
                layout.Tabs(space, _map()) if has_map else space,
                _legend(len(estimates)),
                row_shares=[16, 1 + rows_of(len(estimates))],
            ),
            layout.Tabs(errors, _within_bands()) if has_consistency else errors,
            column_shares=[5, 3] if len(estimates) == 1 else [5, 4],
        ),
    )


def _map() -> Any:
    """Return the map, in a hidden tab, since a viewer requests its tiles from OpenStreetMap."""
    _, layout = sdk()
    return layout.MapView(origin=f"/{scene_entities.MAP}", name="Map")


def _errors(gauge: Gauge, *, is_live: bool, legend: bool) -> Any:
    _, layout = sdk()
    return layout.Vertical(
        layout.TextDocumentView(origin=f"/{scene_entities.SUMMARY}", name="Summary"),
        _plot(
            "Position error and ATE (RMSE) [m]",
            scene_entities.POSITION_ERROR,
            scene_entities.ATE_POSITION,
            scene_entities.REVISED_ATE_POSITION,
        ),
        _plot(
            "Rotation error and RMSE [deg]",
            scene_entities.ROTATION_ERROR,
            scene_entities.ATE_ROTATION,
        ),
        layout.Tabs(
            layout.TextLogView(origin=f"/{scene_entities.EVENTS}", name="Events"),
            _plot("Relative error [m]", scene_entities.RELATIVE_ERROR, legend=legend),
            _plot("Yaw error [deg]", scene_entities.YAW_ERROR),
            *([_plot("Scale", scene_entities.SCALE)] if gauge.has_scale else []),
            *(
                [_plot("Yaw of the alignment [deg]", scene_entities.ALIGNMENT_YAW)]
                if is_live
                else []
            ),
        ),
        name="Errors",
        row_shares=[7, 4, 3, 3],
    )


def _within_bands() -> Any:
    _, layout = sdk()
    names = ("x [m]", "y [m]", "z [m]", "φx [deg]", "φy [deg]", "φz [deg]")
    plots = [_plot(*each) for each in zip(names, scene_entities.ERRORS_WITHIN, strict=True)]
    return layout.Vertical(
        *(layout.Horizontal(plots[axis], plots[axis + 3]) for axis in range(3)),
        _plot("NEES / 6 per pose", scene_entities.NEES, scene_entities.NEES_LIMIT, legend=True),
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
) -> Any:
    _, layout = sdk()
    # Live, only the latest rows are visible: their entities are drawn again as they grow.
    growing = [] if is_live else _drawn_once(estimates)
    overrides: dict[str, list[Any]] = {each: [until_now()] for each in growing}
    if len(estimates) > _MOST_COLOURED:
        hidden = [each.by_error for each in estimates]
    else:  # live, colours are drawn later than the path
        hidden = [] if is_live else [each.path.past for each in estimates]
    for each in hidden:
        overrides.setdefault(each, []).append(layout.EntityBehavior(visible=False))
    return layout.Spatial3DView(
        origin=f"/{scene_entities.WORLD}",
        name="Groundtruth and aligned estimate",
        overrides=overrides,
        background=layout.Background(color=colours.BACKGROUND),
        line_grid=layout.LineGrid3D(visible=True, color=colours.GRID, spacing=_spacing(bounds)),
        eye_controls=_eye(bounds, 1.0 if len(estimates) == 1 else 1.2),
    )


def _drawn_once(estimates: Sequence[scene_entities.EstimateEntities]) -> list[str]:
    """Return the entities of a recorded picture whose rows stay visible."""
    return [
        scene_entities.GroundtruthEntities.path.past,
        *(each.path.past for each in estimates),
        *(each.by_error for each in estimates),
        *(each.correspondences for each in estimates),
        *(each.uncertainty for each in estimates),
    ]


def _plot(name: str, *quantities: str, legend: bool = False) -> Any:
    _, layout = sdk()
    return layout.TimeSeriesView(
        origin="/metrics",
        contents=[f"/metrics/{each}/**" for each in quantities],
        name=name,
        axis_x=whole_run(),
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
    centre, size = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), 1e-2)
    return layout.EyeControls3D(
        position=centre + distance * size * np.array([0.0, -0.52, 0.66]),
        look_target=centre,
        eye_up=(0.0, 0.0, 1.0),
    )
