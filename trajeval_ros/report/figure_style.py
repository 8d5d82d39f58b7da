"""Style and file formats of figures: the default style, overridden by the user's settings.

All properties are matplotlib's settings, including colours and width. Therefore a user's
matplotlibrc and style sheets work as usual.
"""

from __future__ import annotations

import functools
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
# Inches. Enlarged to a 16:9 slide of 13.3 inches, 8 points become 19.
WIDTHS_IN = {"ieee-column": 3.5, "ieee-page": 7.16, "slides": 5.5}
_NARROWEST_IN, _WIDEST_IN = 2.0, 40.0
TEX_SYSTEMS = ("xelatex", "lualatex", "pdflatex")
RAMP = "trajeval"  # name of the colour map

# Fonts with Chinese, Japanese and Korean characters on Linux, macOS and Windows.
_MORE_LETTERS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Micro Hei", "Droid Sans Fallback",
    "PingFang SC", "Hiragino Sans", "Microsoft YaHei", "Malgun Gothic",
)  # fmt: skip

# Sizes are points on paper. `lines.color`, which matplotlib does not use, is the colour of the
# groundtruth, and `axes.edgecolor` that of remarks.
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
    """The user's settings for figures."""

    formats: tuple[str, ...] = ("png",)  # file formats, of `FORMATS`
    width_in: float | None = None  # printed width, inches; None for the style's
    # Whether titles are drawn; the metadata of files have them in any case.
    has_titles: bool = True
    # a matplotlib style sheet that overrides the default style; None for none.
    file: Path | None = None

    @classmethod
    def parse(
        cls, formats: str | None, width: str | None, file: Path | None, *, has_titles: bool
    ) -> FigureStyle:
        """Parse formats such as "pdf,svg" and a width such as "3.5", or one of `WIDTHS_IN`."""
        listed = tuple(dict.fromkeys((formats or "png").split(",")))
        for file_format in listed:
            require_one_of(file_format, FORMATS, "figure format")
        return cls(listed, None if width is None else _width_in(width), has_titles, file)

    def check(self) -> None:
        """Refuse what is not possible, before the evaluation."""
        if self == PLAIN:
            return  # default figures are omitted without matplotlib
        with apply_style(self):
            if "pgf" in self.formats and not any(map(shutil.which, TEX_SYSTEMS)):
                raise InputError(
                    f"format pgf needs LaTeX, one of {', '.join(TEX_SYSTEMS)}; install one, or "
                    "use pdf"
                )


PLAIN = FigureStyle()


def _width_in(text: str) -> float:
    """Return a width in inches from a number or a name."""
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
def apply_style(style: FigureStyle = PLAIN) -> Iterator[None]:
    """Apply the default style, overridden by the user's matplotlib settings and by `style`.

    matplotlib's logged warnings are hidden: its first import warns of a home folder that is not
    writable, and of the font cache when building it takes more than 5 s.
    """
    with _log_level("ERROR"):
        try:
            import matplotlib
            from matplotlib.rcsetup import cycler
        except ImportError as error:
            raise InputError(
                f"figures need matplotlib; install it: {extra_command('plot')}"
            ) from error
        with matplotlib.rc_context(), warnings.catch_warnings():
            # Characters that no installed font has are drawn as boxes; a warning would not help.
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


@contextmanager
def _log_level(level: str) -> Iterator[None]:
    """Set the level of matplotlib's logger."""
    import logging

    logger = logging.getLogger("matplotlib")
    before = logger.level
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(before)


def _set_by_user() -> dict[Any, Any]:
    """Return settings that differ from matplotlib's defaults."""
    import matplotlib

    # All at once: reading the backend alone would select one.
    values, defaults = (
        dict(dict.items(params)) for params in (matplotlib.rcParams, matplotlib.rcParamsDefault)
    )
    return {
        name: value
        for name, value in values.items()
        if name != "backend" and value != defaults.get(name)
    }


def _read_style(path: Path) -> dict[Any, Any]:
    """Return the settings of a style sheet; matplotlib's warnings about it are errors here."""
    import logging

    import matplotlib

    complaints: list[str] = []
    listener = logging.Handler(logging.WARNING)
    listener.emit = lambda record: complaints.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("matplotlib")
    logger.addHandler(listener)
    try:
        if not path.is_file():
            raise InputError(
                f"the style sheet {path} does not exist; give a matplotlib style sheet"
            )
        with _log_level("WARNING"):
            read = matplotlib.rc_params_from_file(path, use_default_template=False)
        settings = dict(dict.items(read))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"the style sheet {path} can't be read: {error}") from error
    finally:
        logger.removeHandler(listener)
    if complaints:
        complaint = complaints[0].strip().split("\n", 1)[0]
        raise InputError(f"the style sheet {path} is not valid: {complaint}")
    settings.pop("backend", None)
    return settings


@functools.lru_cache(maxsize=1)
def _register_ramp() -> None:
    """Register the default colour map in matplotlib."""
    import matplotlib
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list(RAMP, palette.RAMP)
    matplotlib.colormaps.register(ramp, force=True)


@functools.lru_cache(maxsize=1)
def _fonts() -> list[str]:
    """Return matplotlib's own font, and installed fonts with more characters."""
    from matplotlib import font_manager

    installed = set(font_manager.get_font_names())
    return ["DejaVu Sans", *(name for name in _MORE_LETTERS if name in installed)]
