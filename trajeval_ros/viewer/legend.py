"""The legend of the colours, a strip below the paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.viewer import colours
from trajeval_ros.viewer.scene_entities import LEGEND, EstimateEntities
from trajeval_ros.viewer.sdk import sdk

# Width of the strip, height of a row and width of a letter, in units of the view.
WIDTH, ROW = 1000.0, 46.0
_RAMP_END, _NAMES_BEGIN = 180.0, 250.0
_LETTER = 12.0
_MOST_BESIDE = 3
_LINE, _STEPS, _RADIUS, _DOT = 10.0, 64, 6.0, 6.0
_SCALE = f"{LEGEND}/scale"


def declare_legend(recording: Any, estimates: Sequence[EstimateEntities]) -> None:
    """Log the colour scale of errors, and the colours and names of groundtruth and estimates."""
    rerun, _ = sdk()
    ends = np.linspace(0.0, _RAMP_END, _STEPS + 1)
    line = np.stack([ends, np.full(_STEPS + 1, _LINE)], axis=1)
    ramp = rerun.LineStrips2D(
        np.stack([line[:-1], line[1:]], axis=1),
        colors=colours.of_errors(np.linspace(0.0, 1.0, _STEPS), 1.0),
        radii=_RADIUS,
    )
    shown = [
        ("groundtruth", colours.GROUNDTRUTH),
        *((each.name, each.colour) for each in estimates),
    ]
    beside = -(-len(shown) // rows_of(len(estimates)))
    room = (WIDTH - _NAMES_BEGIN) / beside
    row, column = np.divmod(np.arange(len(shown)), beside)
    places = np.stack([_NAMES_BEGIN + (column + 0.5) * room, _LINE + ROW * row], axis=1)
    letters = int(room / _LETTER)
    lines = rerun.Points2D(
        places,
        colors=[colour for _, colour in shown],
        radii=_DOT,
        labels=[shortened(name, letters) for name, _ in shown],
        show_labels=True,
    )
    # An entity takes a kilobyte, so both are in one.
    recording.log(f"{LEGEND}/colours", ramp, lines, static=True)


def rows_of(estimates: int) -> int:
    """Return the number of rows for the names of N estimates and of the groundtruth."""
    return -(-(1 + estimates) // _MOST_BESIDE)


def scale(full_m: float) -> tuple[str, Any]:
    """Return the entity of the colour scale's labels, and the labels from 0 to `full_m`."""
    rerun, _ = sdk()
    row = rerun.Points2D(
        [[0.0, _LINE], [_RAMP_END, _LINE]],
        colors=[colours.of_errors(np.array([each]), 1.0)[0] for each in (0.0, 1.0)],
        radii=_RADIUS,
        labels=["0", f"{full_m:g} m"],
        show_labels=True,
    )
    return _SCALE, row


def shortened(name: str, letters: int) -> str:
    """Return a name with a limited number of letters: the end of a long one."""
    return name if len(name) <= letters else f"…{name[1 - letters :]}"
