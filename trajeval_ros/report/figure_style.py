"""How figures look and what they are saved as: our style, under what the user asks for.

Everything that matplotlib has a setting for is one of its settings here, colours and width
included: so a user's own matplotlibrc and style sheets work as they do elsewhere.
"""

from __future__ import annotations

import functools
import logging
import math
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.formatting import palette
from trajeval_ros.formatting.install_command import extra_command

FORMATS = ("png", "pdf", "svg", "pgf")
# Inches. A slide of 16:9 is 13.3 wide: enlarged to it, type of 8 points is as large as 19.
WIDTHS_IN = {"ieee-column": 3.5, "ieee-page": 7.16, "slides": 5.5}
_NARROWEST_IN, _WIDEST_IN = 2.0, 40.0
TEX_SYSTEMS = ("xelatex", "lualatex", "pdflatex")
RAMP = "trajeval"  # its name among matplotlib's colour maps

# Fonts with Chinese, Japanese and Korean letters, on Linux, macOS and Windows.
_MORE_LETTERS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Micro Hei", "Droid Sans Fallback",
    "PingFang SC", "Hiragino Sans", "Microsoft YaHei", "Malgun Gothic",
)  # fmt: skip

# Sizes are points on paper. `lines.color`, which matplotlib has no use for, is the groundtruth's,
# and `axes.edgecolor` that of remarks.
_STYLE: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "0.35",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 8,
    "figure.figsize": (7.0, 4.3),
    "figure.titlesize": 9,
    "font.size": 8,
    "grid.color": "0.88",
    "grid.linewidth": 0.5,
    "image.cmap": RAMP,
    "legend.borderaxespad": 0.2,
    "legend.columnspacing": 1.4,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.color": "0.2",
    "lines.linewidth": 1.1,
    "pdf.fonttype": 42,
    "pgf.rcfonts": False,
    "ps.fonttype": 42,
    "savefig.dpi": 200,
    "svg.hashsalt": "trajeval",
    "text.parse_math": False,
    "xtick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 7.5,
    "ytick.major.width": 0.6,
}


@dataclass(frozen=True)
class FigureStyle:
    """What the user wants of figures.

    Attributes:
        formats: Of `FORMATS`.
        width_in: As they are printed, inches; None for the style's.
        has_titles: Whether titles are drawn; a file has its title in its metadata nonetheless.
        file: A matplotlib style sheet on top of ours; None for none.
    """

    formats: tuple[str, ...] = ("png",)
    width_in: float | None = None
    has_titles: bool = True
    file: Path | None = None

    @classmethod
    def parse(
        cls, formats: str | None, width: str | None, file: Path | None, *, has_titles: bool
    ) -> FigureStyle:
        """Read "pdf,svg" and "3.5", or one of `WIDTHS_IN`.

        Raises:
            SettingsError: They mean nothing.
        """
        listed = tuple(dict.fromkeys((formats or "png").split(",")))
        for each in listed:
            require_one_of(each, FORMATS, "figure format")
        return cls(listed, None if width is None else _width_in(width), has_titles, file)

    def check(self) -> None:
        """Refuse what can't be done, before anything is computed.

        Raises:
            InputError: matplotlib is asked for something and not installed, the style sheet can't
                be read, or there is no LaTeX for PGF.
        """
        if self == PLAIN:
            return  # figures by default are left out where there is no matplotlib
        with house_style(self):
            if "pgf" in self.formats and not any(map(shutil.which, TEX_SYSTEMS)):
                raise InputError(
                    f"format pgf needs LaTeX, one of {', '.join(TEX_SYSTEMS)}; install one, or "
                    "use pdf"
                )


PLAIN = FigureStyle()


def _width_in(text: str) -> float:
    if text in WIDTHS_IN:
        return WIDTHS_IN[text]
    try:
        width = float(text)
    except ValueError:
        width = math.nan
    if not _NARROWEST_IN <= width <= _WIDEST_IN:
        raise SettingsError(
            f"the figure width {text!r} is not valid; give inches from {_NARROWEST_IN:g} to "
            f"{_WIDEST_IN:g}, or {', '.join(WIDTHS_IN)}"
        )
    return width


@contextmanager
def house_style(style: FigureStyle = PLAIN) -> Iterator[None]:
    """Draw in our style; what the user has set in matplotlib, or says now, goes before it.

    Raises:
        InputError: matplotlib is not installed, or the style sheet can't be read.
    """
    try:
        import matplotlib
        from matplotlib.rcsetup import cycler
    except ImportError as error:
        raise InputError(
            f"figures need matplotlib; install it: {extra_command('plot')}"
        ) from error
    with matplotlib.rc_context(), warnings.catch_warnings():
        # A name in letters that no font here has is drawn as boxes; nobody can mend that now.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        users = _set_by_user()
        _register_ramp()
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        matplotlib.rcParams["axes.prop_cycle"] = cycler(color=palette.ESTIMATES)
        matplotlib.rcParams["font.family"] = _fonts()
        matplotlib.rcParams.update(users)
        if style.file is not None:
            matplotlib.rcParams.update(_read_style(style.file))
        if style.width_in is not None:
            height_in = matplotlib.rcParams["figure.figsize"][1]
            matplotlib.rcParams["figure.figsize"] = (style.width_in, height_in)
        yield


def _set_by_user() -> dict[Any, Any]:
    """Return settings that differ from matplotlib's own: of a matplotlibrc, or set in Python."""
    import matplotlib

    # Not item by item: reading the backend would choose one.
    now, own = (
        dict(dict.items(each)) for each in (matplotlib.rcParams, matplotlib.rcParamsDefault)
    )
    return {
        name: value for name, value in now.items() if name != "backend" and value != own.get(name)
    }


def _read_style(path: Path) -> dict[Any, Any]:
    import matplotlib

    complaints: list[str] = []
    listener = logging.Handler(logging.WARNING)
    listener.emit = lambda record: complaints.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("matplotlib")
    level = logger.level
    logger.addHandler(listener)
    logger.setLevel(logging.WARNING)
    try:
        if not path.is_file():
            raise InputError(
                f"the style sheet {path} does not exist; give a matplotlib style sheet"
            )
        read = matplotlib.rc_params_from_file(path, use_default_template=False)
        found = dict(dict.items(read))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"the style sheet {path} can't be read: {error}") from error
    finally:
        logger.removeHandler(listener)
        logger.setLevel(level)
    if complaints:
        said = complaints[0].strip().split("\n", 1)[0]
        raise InputError(f"the style sheet {path} is not valid: {said}")
    found.pop("backend", None)
    return found


@functools.lru_cache(maxsize=1)
def _register_ramp() -> None:
    """Make our ramp one of matplotlib's colour maps."""
    import matplotlib
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list(RAMP, palette.RAMP)
    matplotlib.colormaps.register(ramp, force=True)


@functools.lru_cache(maxsize=1)
def _fonts() -> list[str]:
    """Return matplotlib's own font, and those that have more letters where they are installed."""
    from matplotlib import font_manager

    installed = set(font_manager.get_font_names())
    return ["DejaVu Sans", *(name for name in _MORE_LETTERS if name in installed)]
