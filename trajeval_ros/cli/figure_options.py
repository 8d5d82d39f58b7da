"""Figure options shared by all verbs that draw."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros.report.figure_style import FORMATS, WIDTHS_IN

FIGURES = "Figures"

FigureFormatOption = Annotated[
    str | None,
    typer.Option(
        metavar="LIST",
        help=f"Formats of figures, separated by commas: {','.join(FORMATS)}. PGF needs LaTeX.",
        rich_help_panel=FIGURES,
    ),
]
FigureWidthOption = Annotated[
    str | None,
    typer.Option(
        metavar="INCHES|PRESET",
        help="Width of figures in print, with a font size of 7 to 9 points: "
        + ", ".join(f"{name} ({width:g})" for name, width in WIDTHS_IN.items())
        + ".",
        rich_help_panel=FIGURES,
    ),
]
NoTitleOption = Annotated[
    bool,
    typer.Option(
        "--no-title",
        help="Figures without titles, for papers. The titles stay in the metadata of the files.",
        rich_help_panel=FIGURES,
    ),
]
StyleOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.mplstyle",
        help="Matplotlib style sheet; overrides the default style and your matplotlibrc. With "
        "`text.usetex: True`, LaTeX sets all text.",
        rich_help_panel=FIGURES,
    ),
]
