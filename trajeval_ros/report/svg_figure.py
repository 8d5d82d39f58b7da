"""Figures as SVG: as elements of a page with the page's styles, or as a file for a paper."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from trajeval_ros.formatting import palette
from trajeval_ros.report.svg_panel import LINE_PX, SvgPanel, shown, text_width

GROUNDTRUTH = ("groundtruth", "groundtruth")  # its key in a legend
WIDE = 480.0  # width of a file, pixels
_KEY_PX, _GAP_PX = 28.0, 16.0  # width of a legend's line and of the gap between keys
_LINES_PX = 10.0  # coordinates of lines are in tenths of pixels
_DASHES_PX = ((6.0, 3.0), (6.0, 2.0, 1.5, 2.0), (1.5, 2.5))  # of the classes d1 to d3
_FONTS = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
_PAPER, _INK, _GRID, _GROUNDTRUTH = "#ffffff", "#1b1f24", "#e4e7eb", "#555b63"


@dataclass(frozen=True, eq=False)
class Picture:
    """A part of a figure."""

    panels: Sequence[SvgPanel]
    size: tuple[float, float]  # width and height, pixels
    label: str  # description for screen readers
    name: str = ""  # text above the picture; empty for none
    kind: str = ""  # its CSS classes

    @property
    def content(self) -> str:
        """SVG elements of all panels."""
        return "".join(part for panel in self.panels for part in panel.parts)

    def to_html(self) -> str:
        """Return the picture as an element of a page."""
        wide, high = self.size
        return (
            f'<svg role="img" aria-label="{shown(self.label)}" viewBox="0 0 {wide:g} {high:g}" '
            f'style="max-width:{1.35 * wide:.0f}px">{self.content}</svg>'
        )


@dataclass(frozen=True, eq=False)
class SvgFigure:
    """A figure of one or several pictures."""

    keys: Sequence[tuple[str, str]]  # CSS classes and names in the legend
    pictures: Sequence[Picture]  # the pictures; those with names are shown next to one another

    def to_html(self) -> str:
        """Return the figure as elements of a page, with the classes of `style.css.j2`."""
        keys = [
            f'<button class="key {kind}" aria-pressed="true">{shown(name)}</button>'
            for kind, name in self.keys
        ]
        legend = f'<p class="legend">{" ".join(keys)}</p>'
        if not any(each.name for each in self.pictures):
            return legend + "".join(each.to_html() for each in self.pictures)
        named = (
            f'<div><p class="{each.kind} name">{shown(each.name)}</p>{each.to_html()}</div>'
            for each in self.pictures
        )
        return f'{legend}<div class="small">{"".join(named)}</div>'

    def to_file(self, title: str) -> str:
        """Return the figure as a file in the light colours, with plain styles for converters."""
        parts = [*self._legend()]
        x = row_high = 0.0
        y = LINE_PX * len(self._legend_rows()) + 4.0
        for each in self.pictures:
            wide, high = each.size
            above = LINE_PX + 4.0 if each.name else 0.0
            if x and x + wide > WIDE:
                x, y, row_high = 0.0, y + row_high, 0.0
            if each.name:
                parts.append(
                    f'<text class="n {each.kind}" x="{x + 12.0:g}" y="{y + LINE_PX:g}">'
                    f"{shown(each.name)}</text>"
                )
            parts.append(f'<g transform="translate({x:g} {y + above:g})">{each.content}</g>')
            x, row_high = x + wide, max(row_high, above + high)
        size = f"{WIDE:g} {y + row_high:g}"
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDE:g}" height="{y + row_high:g}" '
            f'viewBox="0 0 {size}"><title>{shown(title)}</title><style>{_style()}</style>'
            f'<rect width="100%" height="100%" fill="{_PAPER}"/>{"".join(parts)}</svg>\n'
        )

    def _legend(self) -> Iterator[str]:
        """Yield the elements of the legend."""
        for row, keys in enumerate(self._legend_rows()):
            x, y = 12.0, LINE_PX * (row + 1)
            for kind, name in keys:
                points = _LINES_PX * x, _LINES_PX * (y - 4.0), _LINES_PX * (_KEY_PX - 6.0)
                yield (
                    f'<path class="c {kind}" transform="scale(.1)" '
                    f'd="M{points[0]:.0f} {points[1]:.0f}h{points[2]:.0f}"/>'
                    f'<text x="{x + _KEY_PX:.1f}" y="{y:g}">{shown(name)}</text>'
                )
                x += _key_width(name)

    def _legend_rows(self) -> list[list[tuple[str, str]]]:
        """Return the keys of the legend by row."""
        rows: list[list[tuple[str, str]]] = []
        room = 0.0
        for kind, name in self.keys:
            if _key_width(name) > room:
                rows.append([])
                room = WIDE
            rows[-1].append((kind, name))
            room -= _key_width(name)
        return rows


def _key_width(name: str) -> float:
    return _KEY_PX + text_width(name) + _GAP_PX


@functools.cache
def _style() -> str:
    """Return the styles of a file: no variables, which converters to PDF do not support."""
    rules = [
        f"text{{font-family:{_FONTS};font-size:12px;fill:{_INK}}}",
        ".a{fill:none}.m{text-anchor:middle}.e{text-anchor:end}.n{font-weight:600}",
        f".g{{stroke:{_GRID};fill:none}}",
        f".c{{fill:none;stroke-width:{1.3 * _LINES_PX:g};stroke-linejoin:round}}",
        f".c.groundtruth{{stroke:{_GROUNDTRUTH};stroke-width:{2.2 * _LINES_PX:g}}}",
        ".b{fill-opacity:.3}",
        f".d{{stroke:{_INK};stroke-width:1.5;fill:none}}",
        f".o{{fill:{_PAPER};stroke:{_INK};stroke-width:1.2}}",
    ]
    for place, colour in enumerate(palette.ESTIMATES):
        rules.append(
            f".c.s{place},.b.s{place}{{stroke:{colour}}}"
            f".b.s{place},.p.s{place},.n.s{place}{{fill:{colour}}}"
        )
    for number, dashes in enumerate(_DASHES_PX, 1):
        of_boxes = " ".join(f"{each / 1.5:g}" for each in dashes)
        of_lines = " ".join(f"{_LINES_PX * each:g}" for each in dashes)
        rules.append(
            f".b.d{number}{{stroke-dasharray:{of_boxes}}}"
            f".c.d{number}{{stroke-dasharray:{of_lines}}}"
        )
    return "".join(rules)
