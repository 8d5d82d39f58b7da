"""Writing of figures in all formats, with LaTeX where a format needs it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import latex_text, one_line
from trajeval_ros.io.writing import refused_by_disk, temporary_folder
from trajeval_ros.report.canvas import Drawing, grow
from trajeval_ros.report.figure_style import TEX_SYSTEMS, FigureStyle, apply_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(figure: Figure, path: Path, file_format: str, title: str = "") -> Path:
    """Write a figure; equal figures give equal bytes.

    `title`: for the metadata; by default the title that is drawn.
    """
    import matplotlib

    title = one_line(title or " ".join(figure.get_suptitle().split()))
    metadata: dict[str, dict[str, Any]] = {
        "png": {"Software": None, "Title": title},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None, "Title": title},
        "svg": {"Date": None, "Creator": None, "Title": title},
    }
    by_latex = file_format == "pgf" or matplotlib.rcParams["text.usetex"]
    with matplotlib.rc_context():
        if by_latex:
            _prepare_for_latex(figure)
        try:
            if file_format == "pgf":
                figure.savefig(path, format=file_format)
            else:
                figure.savefig(path, format=file_format, metadata=metadata[file_format])
        except (RuntimeError, FileNotFoundError, ValueError) as error:
            if not by_latex:
                raise
            reason = " ".join(str(error).split())[:200]
            raise InputError(
                f"LaTeX can't typeset a figure: {reason}; use format pdf, which needs no LaTeX"
            ) from error
    return path


def save_all(figures: Mapping[str, Drawing], folder: Path, style: FigureStyle) -> list[Path]:
    """Draw figures in a style, one after the other, and write them in all of its formats."""
    written = []
    with (
        apply_style(style),
        refused_by_disk(f"figures in {folder}"),
        temporary_folder("figures", folder) as made,
    ):
        for name, draw in figures.items():
            for file_format in style.formats:
                figure = draw()
                if not style.has_titles:
                    hide_title(figure)
                save(figure, made / f"{name}.{file_format}", file_format)
                written.append(folder / f"{name}.{file_format}")
        # PGF files can have additional image files.
        for file in sorted(made.iterdir()):
            file.replace(folder / file.name)
    return written


def hide_title(figure: Figure) -> None:
    """Hide the title of a figure and reduce its height; the metadata keep the title."""
    for text in figure.texts:
        if text.get_text() == figure.get_suptitle():
            grow(figure, -1 - text.get_text().count("\n"))
            text.set_visible(False)
            text.set_in_layout(False)


def _prepare_for_latex(figure: Figure) -> None:
    """Escape all text of a figure, so that LaTeX prints it unchanged."""
    import matplotlib
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter

    systems = [system for system in TEX_SYSTEMS if shutil.which(system)]
    chosen = matplotlib.rcParams["pgf.texsystem"]
    if systems and shutil.which(chosen) is None:
        matplotlib.rcParams["pgf.texsystem"] = systems[0]
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_text("\n".join(map(latex_text, text.get_text().split("\n"))))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            named = axis.get_major_formatter()
            if isinstance(named, FuncFormatter):
                axis.set_major_formatter(_escaped(named))


def _escaped(named: Any) -> Any:
    """Return a formatter whose tick labels are escaped for LaTeX."""
    from matplotlib.ticker import FuncFormatter

    return FuncFormatter(lambda value, place: latex_text(named(value, place)))
