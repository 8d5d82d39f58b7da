"""The examination of a groundtruth as a table, sentences and a figure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.calibration.groundtruth_quality.quality_causes import HALF_WIDTH
from trajeval_ros.formatting.numbers import four_digits
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.report import canvas
from trajeval_ros.report.console import Console, Table, show

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from trajeval_ros.calibration.groundtruth_quality.examine import ExaminedGroundtruth, Fits

_WORDS = ("cause", "verdict")
_NUMBERS = ("value", "+- 95 %", "unit", "p")
_LEAST = 1e-3  # mm or deg; smaller residuals are drawn at it
_HORIZONS = (("rotation", slice(0, 3), "deg"), ("lever arm", slice(3, 6), "mm"))


def print_groundtruth(
    terminal: Console, examined: ExaminedGroundtruth, saved: Sequence[Path]
) -> None:
    """Print the table of causes, the findings, the notes, and the repaired groundtruth."""
    rows = [
        (
            cause.name.replace("_", " "),
            cause.verdict,
            _shown(cause.value),
            _shown(cause.half_width),
            cause.unit,
            _shown(cause.p_value, is_probability=True),
        )
        for cause in examined.causes.values()
    ]
    show(terminal, Table("", _WORDS, _NUMBERS, rows))
    for line in _sentences(examined):
        terminal.print(line, soft_wrap=True)
    for path in saved:
        terminal.print(f"saved {path}", soft_wrap=True)


def _shown(value: float | None, *, is_probability: bool = False) -> str:
    if value is None:
        return ""
    if is_probability:
        return "< 1e-6" if value < 1e-6 else f"{value:.2g}"
    return four_digits(value)


def _sentences(examined: ExaminedGroundtruth) -> Iterator[str]:
    yield from (item.sentence for item in examined.significant)
    if not examined.significant:
        yield "No cause of errors is significant."
    yield from (f"note: {note}" for note in examined.notes)
    fits = examined.fits
    if fits is None:
        return
    assert fits.repaired.covariances is not None
    variances = np.median(np.einsum("nii->ni", fits.repaired.covariances), axis=0)
    position_m, rotation_rad = np.sqrt([variances[:3].mean(), variances[3:].mean()])
    for what, metres, radians in (
        ("Noise of a pose per axis", fits.position_noise_m, fits.rotation_noise_rad),
        ("Repaired groundtruth of the IMU, standard deviation per axis", position_m, rotation_rad),
    ):
        text = f"{what}: {1e3 * metres:.2g} mm"
        if radians is not None:
            degrees = math.degrees(radians)
            text += f", {degrees:.2g} deg (--groundtruth-noise {metres:.2g},{degrees:.2g})"
        yield f"{text}."
    yield (
        "Its covariances are lower limits: the IMU does not reveal errors that last for more "
        "than a second."
    )


def groundtruth_figure(original: Trajectory, examined: ExaminedGroundtruth, fits: Fits) -> Figure:
    """Draw the residuals over time with the jumps, and the calibration of both horizons."""
    named = canvas.short_names([original.name or "groundtruth"])
    figure = canvas.new_figure(5.2, f"{named[0]}, {len(examined.significant)} significant causes")
    grid = figure.add_gridspec(3, 2)
    lengths = fits.short.residuals * [1e3, 180.0 / math.pi]
    first = int(original.stamps.min())
    kinds = (("position", "mm"), ("rotation", "deg"))
    known = 1 if fits.rotation_noise_rad is None else 2  # without orientations only positions
    for row, (kind, unit) in enumerate(kinds[:known]):
        axes = figure.add_subplot(grid[row, :])
        colour, _ = canvas.line_style(0)
        shown = np.maximum(lengths[:, row], _LEAST)
        axes.plot(fits.short.seconds, shown, color=colour, linewidth=0.6)
        jumps = [jump.stamp_ns for jump in fits.checks.jumps if jump.kind == kind]
        for number, stamp in enumerate(jumps):
            label, second = "" if number else "jump", (stamp - first) / NANOSECONDS
            axes.axvline(
                second, color=canvas.text_color(), linewidth=0.7, linestyle=":", label=label
            )
        axes.set_yscale("log")
        axes.set_ylim(_LEAST / 1.5, 1.5 * max(10.0 * _LEAST, float(shown.max())))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylabel(f"{kind}\nresidual [{unit}]")
        axes.set_xlim(0.0, float(fits.short.seconds[-1]))
        if jumps:
            axes.legend(loc="upper right")
    axes.set_xlabel("time since the first pose [s]")
    for column, (name, columns, unit) in enumerate(_HORIZONS[-known:]):
        axes = figure.add_subplot(grid[2, column])
        for place, (label, fit) in enumerate((("0.1 s", fits.short), ("2 s", fits.long))):
            colour, _ = canvas.line_style(place)
            axes.errorbar(
                np.arange(3) + 0.2 * place - 0.1,
                fit.values[columns],
                HALF_WIDTH * fit.sigmas[columns],
                color=colour, fmt="o", markersize=3, capsize=2, label=f"over {label}",
            )  # fmt: skip
        axes.axhline(0.0, color=canvas.soft_ink(), linewidth=0.6)
        axes.set_xticks(range(3), labels=list("xyz"))
        axes.set_xlim(-0.5, 2.5)
        axes.set_ylabel(f"{name} [{unit}]")
        if not column:
            axes.legend(loc="best")
    return figure
