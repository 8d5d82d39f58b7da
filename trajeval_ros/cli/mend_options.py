"""Options that change how poses are read."""

from __future__ import annotations

from typing import Annotated

import typer

MEND = "Corrections (docs/diagnosis.md)"

EstimateScaleOption = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Metres per unit of the estimates' positions: 0.001 for millimetres. Default: 1.",
        rich_help_panel=MEND,
    ),
]
GroundtruthScaleOption = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Metres per unit of the groundtruth's positions. Default: 1.",
        rich_help_panel=MEND,
    ),
]
QuaternionOrderOption = Annotated[
    str | None,
    typer.Option(
        metavar="ORDER[,ORDER]",
        help="Order of quaternions, xyzw (as read) or wxyz: one for all, or one for the "
        "groundtruth and one for the estimates, as in xyzw,wxyz.",
        rich_help_panel=MEND,
    ),
]
InverseOption = Annotated[
    str | None,
    typer.Option(
        metavar="LIST",
        help="Poses to invert (world in body instead of body in world): groundtruth, estimate, "
        "groundtruth-rotations or estimate-rotations.",
        rich_help_panel=MEND,
    ),
]
EstimateAxesOption = Annotated[
    str | None,
    typer.Option(
        metavar="AXES",
        help="Permutation and signs of the estimates' axes, as in x,-y,z. With positions=y,z,x, "
        "only positions change.",
        rich_help_panel=MEND,
    ),
]
ClockRateOption = Annotated[
    float | None,
    typer.Option(
        metavar="PPM",
        help="Rate correction of the estimates' clock, in parts per million, from the first "
        "timestamp.",
        rich_help_panel=MEND,
    ),
]
SwapOption = Annotated[
    bool,
    typer.Option("--swap", help="Groundtruth and estimate exchanged.", rich_help_panel=MEND),
]
FixOption = Annotated[
    str | None,
    typer.Option(
        metavar="CAUSE|suggested",
        help="Mistake to correct if the diagnosis finds it; the errors before and after are "
        "printed. suggested corrects the most severe one.",
        rich_help_panel=MEND,
    ),
]
