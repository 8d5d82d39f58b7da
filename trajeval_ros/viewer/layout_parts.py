"""Common parts of all layouts: time ranges and panels."""

from __future__ import annotations

from typing import Any

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


def until_now() -> Any:
    """Return the times up to the cursor, for entities that grow during the run."""
    _, layout = sdk()
    return layout.VisibleTimeRanges(
        [
            layout.VisibleTimeRange(
                TIMELINE,
                start=layout.TimeRangeBoundary.infinite(),
                end=layout.TimeRangeBoundary.cursor_relative(),
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
