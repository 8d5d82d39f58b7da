"""The layout at first open: the paths at the left, the numbers at the right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.viewer import colours, scene_entities
from trajeval_ros.viewer.sdk import sdk

_MOST_COLOURED = 1  # estimates that are told apart by colour can't be coloured by error


def blueprint(
    estimates: Sequence[scene_entities.EstimateEntities],
    gauge: Gauge,
    *,
    is_live: bool,
    has_consistency: bool = False,
    bounds: tuple[Floats, Floats] | None = None,
) -> Any:
    """Return the layout.

    Args:
        estimates: What is drawn.
        gauge: Of the alignments.
        is_live: Follow what comes; else the whole run is there already.
        has_consistency: Whether errors are drawn within their bands.
        bounds: Least and greatest coordinates (3,), (3,) of what is drawn, if known.
    """
    _, layout = sdk()
    errors = _errors(gauge, is_live=is_live)
    return layout.Blueprint(
        layout.Horizontal(
            _space(estimates, is_live=is_live, bounds=bounds),
            layout.Tabs(errors, _within_bands()) if has_consistency else errors,
            column_shares=[5, 3],
        ),
        layout.TimePanel(
            state="collapsed", timeline=scene_entities.TIMELINE, play_state="following"
        ),
        layout.SelectionPanel(state="collapsed"),
        layout.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def _errors(gauge: Gauge, *, is_live: bool) -> Any:
    _, layout = sdk()
    return layout.Vertical(
        layout.TextDocumentView(origin=f"/{scene_entities.SUMMARY}", name="How wrong is it?"),
        _plot(
            "Position error [m]",
            scene_entities.POSITION_ERROR,
            scene_entities.ATE_POSITION,
            scene_entities.REVISED_ATE_POSITION,
            legend=True,
        ),
        _plot("Rotation error [deg]", scene_entities.ROTATION_ERROR, scene_entities.ATE_ROTATION),
        layout.Tabs(
            layout.TextLogView(origin=f"/{scene_entities.EVENTS}", name="Events"),
            _plot("Relative error [m]", scene_entities.RELATIVE_ERROR, legend=True),
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
        _plot(
            "NEES / 6 of each pose", scene_entities.NEES, scene_entities.NEES_LIMIT, legend=True
        ),
        name="Errors within 3 sigma",
    )


def _space(
    estimates: Sequence[scene_entities.EstimateEntities],
    *,
    is_live: bool,
    bounds: tuple[Floats, Floats] | None,
) -> Any:
    _, layout = sdk()
    until_now = layout.VisibleTimeRanges(
        [
            layout.VisibleTimeRange(
                scene_entities.TIMELINE,
                start=layout.TimeRangeBoundary.infinite(),
                end=layout.TimeRangeBoundary.cursor_relative(),
            )
        ]
    )
    growing = [
        scene_entities.GroundtruthEntities.path.past,
        *(each.path.past for each in estimates),
    ]
    if not is_live:
        growing += [each.by_error for each in estimates]
        growing += [each.correspondences for each in estimates]
        growing += [each.uncertainty for each in estimates]
    overrides: dict[str, list[Any]] = {each: [until_now] for each in growing}
    if len(estimates) > _MOST_COLOURED:
        hidden = [each.by_error for each in estimates]
    else:  # live, the colours come later than the path
        hidden = [] if is_live else [each.path.past for each in estimates]
    for each in hidden:
        overrides.setdefault(each, []).append(layout.EntityBehavior(visible=False))
    return layout.Spatial3DView(
        origin=f"/{scene_entities.WORLD}",
        name="Groundtruth, and the estimate aligned with it",
        overrides=overrides,
        background=layout.Background(color=colours.BACKGROUND),
        line_grid=layout.LineGrid3D(visible=True, color=colours.GRID, spacing=_spacing(bounds)),
        eye_controls=_eye(bounds),
    )


def _plot(name: str, *quantities: str, legend: bool = False) -> Any:
    rerun, layout = sdk()
    # The whole run, and not the half minute about the cursor.
    everything = rerun.TimeRange(
        start=layout.TimeRangeBoundary.infinite(), end=layout.TimeRangeBoundary.infinite()
    )
    return layout.TimeSeriesView(
        origin="/metrics",
        contents=[f"/metrics/{each}/**" for each in quantities],
        name=name,
        axis_x=layout.TimeAxis(link="independent", view_range=everything),
        plot_legend=layout.PlotLegend(layout.Corner2D.LeftTop, visible=legend),
    )


def _spacing(bounds: tuple[Floats, Floats] | None) -> float:
    """Return a round width of the grid's squares, about twenty of them across the picture."""
    if bounds is None:
        return 1.0
    rough = max(float((bounds[1] - bounds[0]).max()), 1e-3) / 20.0
    decade = 10.0 ** np.floor(np.log10(rough))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step * decade - rough)) * decade)


def _eye(bounds: tuple[Floats, Floats] | None) -> Any:
    """Return a view of everything from the south, from above at an angle."""
    if bounds is None:
        return None
    _, layout = sdk()
    low, high = bounds
    centre, size = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), 1e-2)
    return layout.EyeControls3D(
        position=centre + size * np.array([0.0, -0.52, 0.66]),
        look_target=centre,
        eye_up=(0.0, 0.0, 1.0),
    )
