"""Figures as elements of a page, in the page's colours, light and dark."""

from __future__ import annotations

import io
import re
from html import escape
from typing import TYPE_CHECKING

from trajeval_ros.formatting import palette
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Parts of matplotlib's SVG that a page doesn't need: metadata, styles, names of groups, spaces.
_OMITTED = re.compile(
    r'<metadata>.*?</metadata>|<style[^>]*>.*?</style>|(?<=<g) id="[^"]*"|(?<=\n) +', re.DOTALL
)
_SIZE = re.compile(r' width="([\d.]+)pt" height="[\d.]+pt"', re.ASCII)
_PLACE = re.compile(r' (?:d|x|y|transform)="[^"]*"')
_FINE = re.compile(r"(?<=\d\.\d\d)\d+", re.ASCII)  # decimals below a hundredth of a point
_STYLE = re.compile(r' style="[^"]*"')
_COLOUR = re.compile(r"#[0-9a-f]{6}")


def page_figure(figure: Figure, label: str) -> str:
    """Return a figure as an SVG element with the variables of `style.css.j2` as its colours.

    `label`: description for screen readers.
    """
    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    svg = text.getvalue()
    svg = _OMITTED.sub("", svg[svg.index("<svg ") :])
    svg = _PLACE.sub(lambda place: _FINE.sub("", place[0]), svg)
    # Text has the size of the page's small text at this width.
    svg = _SIZE.sub(
        lambda size: (
            f' role="img" aria-label="{escape(one_line(label))}" '
            f'style="max-width:{1.9 * float(size[1]):.0f}px"'
        ),
        svg,
        count=1,
    )
    colours = _page_colours()
    return _STYLE.sub(
        lambda style: _COLOUR.sub(lambda code: colours.get(code[0], code[0]), style[0]), svg
    )


def _page_colours() -> dict[str, str]:
    """Return the page's colours by those of the current style."""
    import matplotlib
    from matplotlib.colors import to_hex

    by_code = {}
    for place, colour in enumerate(palette.ESTIMATES):
        by_code[str(canvas.tint(colour))] = (
            f"color-mix(in srgb, var(--s{place}) 35%, var(--paper))"
        )
        by_code[colour] = f"var(--s{place})"
    return by_code | {
        to_hex(canvas.paper()): "var(--paper)",
        to_hex(matplotlib.rcParams["grid.color"]): "var(--grid)",
        to_hex(canvas.groundtruth_colour()): "var(--groundtruth)",
        to_hex(canvas.soft_ink()): "var(--soft)",
        to_hex(canvas.text_color()): "var(--ink)",
    }
