"""Texts that were read once and kept: what a command prints, what a figure shows.

A test compares what is made now with the kept text, so a change of an output is a difference
that a reviewer reads. With KEEP=1 in the environment the texts are written anew instead, except
lines with numbers that differ by rounding.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Iterable, Iterator
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from paths import ROOT

from trajeval_ros import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KEPT = ROOT / "tests" / "data" / "kept"
_NUMBER = re.compile(r"([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)")
_FEW = 8  # numbers that are written one by one
_LOOKS = (
    "label", "text", "color", "edgecolor", "facecolor", "linewidth", "linestyle", "marker",
    "markersize", "alpha", "zorder", "fontsize", "ha", "va", "rotation", "offsets", "array",
    "extent", "clim", "widths", "heights", "angles", "visible",
)  # fmt: skip
_HASH = r"\b[0-9a-f]{64}\b"  # of inputs, whose last digits differ as well
_LAST_DIGIT = 2e-3  # other versions of numpy and scipy round the third or fourth digit otherwise


def assert_kept(name: str, text: str) -> None:
    """Compare a text with the kept one: equal words, and numbers equal but for rounding."""
    text = re.sub(_HASH, "HASH", text.replace(__version__, "VERSION"))
    path = _KEPT / f"{name}.txt"
    if os.environ.get("KEEP"):
        before = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        path.write_text(_with_kept_digits(before, text.splitlines()), encoding="utf-8")
    kept = path.read_text(encoding="utf-8").splitlines()
    for before, now in zip_longest(kept, text.splitlines()):
        if before is None or now is None or not _alike(before, now):
            difference = difflib.unified_diff(kept, text.splitlines(), "kept", "now", n=0)
            raise AssertionError("\n".join(difference))


def _with_kept_digits(before: list[str], now: list[str]) -> str:
    """Return a new text; of lines that differ by rounding, the kept one."""
    keys = [[_NUMBER.sub("0", line) for line in lines] for lines in (before, now)]
    lines = list(now)
    for block in difflib.SequenceMatcher(None, *keys, autojunk=False).get_matching_blocks():
        for old, new in zip(
            range(block.a, block.a + block.size),
            range(block.b, block.b + block.size),
            strict=True,
        ):
            if _alike(before[old], now[new]):
                lines[new] = before[old]
    return "".join(f"{line}\n" for line in lines)


def _alike(before: str, now: str) -> bool:
    old, new = (_NUMBER.split(" ".join(line.split())) for line in (before, now))
    return old[::2] == new[::2] and all(map(_equal, old[1::2], new[1::2]))


def _equal(old: str, new: str) -> bool:
    if old.isdigit() and new.isdigit():  # a count
        return old == new
    return math.isclose(float(old), float(new), rel_tol=_LAST_DIGIT, abs_tol=1e-9)


def described(figure: Figure) -> str:
    """Return what a figure of matplotlib shows, one line for each thing that is drawn."""
    figure.draw_without_rendering()
    lines = [
        f"figure {_short(figure.get_size_inches())}",
        *_artists(figure.texts, has_places=False),
    ]
    lines += [_legend(legend) for legend in figure.legends]
    for axes in figure.axes:
        lines += ["", f"axes {'shown' if axes.get_visible() else 'hidden'} {axes.get_aspect()}"]
        lines.append(f"titles {axes.get_title('left')!r} {axes.get_title()!r}")
        for axis in axes._axis_map.values():
            lines.append(
                f"{axis.axis_name}-axis {axis.get_label_text()!r} {axis.get_scale()} "
                f"{_short(axis.get_view_interval())} grid {axis._major_tick_kw.get('gridOn')} "
                f"{[tick.get_text() for tick in axis.get_ticklabels() if tick.get_visible()]}"
            )
        lines += [_legend(axes.get_legend())] if axes.get_legend() else []
        drawn = (axes.lines, axes.collections, axes.patches, axes.images, axes.texts)
        lines += [line for artists in drawn for line in _artists(artists)]
    return "\n".join(lines) + "\n"


def _legend(legend: Any) -> str:
    return f"legend {[text.get_text() for text in legend.get_texts()]} in {legend._ncols}"


def _artists(artists: Iterable[Any], *, has_places: bool = True) -> Iterator[str]:
    for artist in artists:
        looks = {name: getattr(artist, f"get_{name}", lambda: None)() for name in _LOOKS}
        if looks["angles"] is not None:  # of a circle, any; as the processor rounds
            is_circle = np.isclose(looks["widths"], looks["heights"], rtol=1e-6)
            looks["angles"] = np.where(is_circle, 0.0, looks["angles"])
        if has_places:
            looks["at"] = _places(artist)
        result = [f"{name} {shortened(look)}" for name, look in looks.items() if look is not None]
        kind = type(artist).__name__.removeprefix("FillBetween")  # since matplotlib 3.10
        yield f"{kind}: {', '.join(result)}"


def _places(artist: Any) -> Any:
    """Return the points of an artist, in the coordinates of the data if it has any."""
    if hasattr(artist, "get_position"):
        return artist.get_position()
    paths = artist.get_paths() if hasattr(artist, "get_paths") else [artist.get_path()]
    return np.concatenate([path.vertices for path in paths]) if paths else []


def shortened(value: Any) -> str:
    """Return a short text of an attribute; of many numbers only their ends and bounds."""
    if value is None or isinstance(value, str):
        return repr(value)
    try:
        numbers = np.ma.filled(np.ma.asarray(value, dtype=float), np.nan)
    except (TypeError, ValueError):
        return re.sub(r" at 0x\w+", "", str(value))
    if numbers.size <= _FEW:
        return _short(numbers)
    is_points = numbers.ndim == 2 and numbers.shape[1] <= 4 and np.isfinite(numbers).all()
    rows = numbers if is_points else numbers[np.isfinite(numbers)].reshape(-1, 1)
    if not len(rows):
        return f"{numbers.shape} not finite"
    parts = (rows[0], rows[-1], rows.min(axis=0), rows.max(axis=0), rows.mean(axis=0))
    return f"{numbers.shape} {' '.join(map(_short, parts))}"


def _short(numbers: Any) -> str:
    return f"[{' '.join(f'{item:.4g}' for item in np.ravel(numbers))}]"
