"""The examination of a groundtruth as table rows, sentences and a figure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import four_digits
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from trajeval_ros.calibration.groundtruth_doctor.examine import ExaminedGroundtruth, Fits

WORDS = ("cause", "verdict")
NUMBERS = ("value", "+- 95 %", "unit", "p")
_T95 = 2.201  # Student's t with 11 degrees of freedom
_HORIZONS = (("rotation", slice(0, 3), "deg"), ("lever arm", slice(3, 6), "mm"))


def cause_rows(found: ExaminedGroundtruth) -> list[tuple[str, ...]]:
    """Return a row per cause."""
    return [
        (
            each.name.replace("_", " "),
            each.verdict,
            "" if each.value is None else four_digits(each.value),
            "" if each.half_width is None else four_digits(each.half_width),
            each.unit,
            ""
            if each.p_value is None
            else "< 1e-6"
            if each.p_value < 1e-6
            else f"{each.p_value:.2g}",
        )
        for each in found.causes.values()
    ]


def sentences(found: ExaminedGroundtruth, saved: Sequence[Path]) -> Iterator[str]:
    """Yield the findings, the notes, and a line on the repaired groundtruth."""
    yield from (each.sentence for each in found.significant)
    if not found.significant:
        yield "No cause of errors is significant."
    yield from (f"note: {each}" for each in found.notes)
    fits = found.fits
    if fits is None:
        return
    noise_m, noise_deg = fits.position_noise_m, math.degrees(fits.rotation_noise_rad)
    yield (
        f"Noise of a pose per axis: {1e3 * noise_m:.2g} mm, {noise_deg:.2g} deg "
        f"(--groundtruth-noise {noise_m:.2g},{noise_deg:.2g})."
    )
    assert fits.repaired.covariances is not None
    variances = np.median(np.einsum("nii->ni", fits.repaired.covariances), axis=0)
    position_m, rotation_rad = np.sqrt([variances[:3].mean(), variances[3:].mean()])
    rotation_deg = math.degrees(rotation_rad)
    yield (
        f"Repaired groundtruth of the IMU, standard deviation per axis: {1e3 * position_m:.2g} "
        f"mm, {rotation_deg:.2g} deg (--groundtruth-noise {position_m:.2g},{rotation_deg:.2g})."
    )
    yield (
        "Its covariances are lower limits: the IMU does not reveal errors that last for more "
        "than a second."
    )
    yield from (f"saved {path}" for path in saved)


def groundtruth_figure(original: Trajectory, found: ExaminedGroundtruth, fits: Fits) -> Figure:
    """Draw the residuals over time with the jumps, and the calibration of both horizons."""
    named = canvas.short_names([original.name or "groundtruth"])
    figure = canvas.new_figure(5.2, f"{named[0]}, {len(found.significant)} significant causes")
    grid = figure.add_gridspec(3, 2)
    lengths = fits.short.residuals * [1e3, 180.0 / math.pi]
    first = int(original.stamps.min())
    for row, (kind, unit) in enumerate((("position", "mm"), ("rotation", "deg"))):
        axes = figure.add_subplot(grid[row, :])
        colour, _ = canvas.line_style(0)
        shown = np.maximum(lengths[:, row], 1e-6)
        axes.plot(fits.short.seconds, shown, color=colour, linewidth=0.6)
        jumps = [
            (each.stamp_ns - first) / NANOSECONDS
            for each in fits.checks.jumps
            if each.kind == kind
        ]
        for number, second in enumerate(jumps):
            label = "jump" if not number else None
            axes.axvline(second, color=canvas.ink(), linewidth=0.7, linestyle=":", label=label)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylabel(f"{kind}\nresidual [{unit}]")
        axes.set_xlim(0.0, float(fits.short.seconds[-1]))
        if jumps:
            axes.legend(loc="upper right")
    axes.set_xlabel("time since the first pose [s]")
    for column, (name, columns, unit) in enumerate(_HORIZONS):
        axes = figure.add_subplot(grid[2, column])
        for place, (label, fit) in enumerate((("0.1 s", fits.short), ("2 s", fits.long))):
            colour, _ = canvas.line_style(place)
            axes.errorbar(
                np.arange(3) + 0.2 * place - 0.1,
                fit.values[columns],
                _T95 * fit.sigmas[columns],
                color=colour, fmt="o", markersize=3, capsize=2, label=f"over {label}",
            )  # fmt: skip
        axes.axhline(0.0, color=canvas.soft_ink(), linewidth=0.6)
        axes.set_xticks(range(3), labels=list("xyz"))
        axes.set_xlim(-0.5, 2.5)
        axes.set_ylabel(f"{name} [{unit}]")
        if not column:
            axes.legend(loc="best")
    return figure
