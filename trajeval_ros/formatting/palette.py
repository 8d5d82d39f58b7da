"""The colours of figures, reports and pictures for Rerun: one palette and one ramp for all."""

from __future__ import annotations

# Okabe and Ito's, which the colour-blind can tell apart, without the too light yellow. The first
# one is none of the ramp's: an estimate is told from its path coloured by error.
ESTIMATES = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
# The same, lighter, on a dark ground.
ESTIMATES_ON_DARK = ("#ff8f47", "#4da6dd", "#35c79a", "#e3a1c6", "#f0b942", "#8accf3")

# matplotlib's viridis (CC0) in equal steps, without its darkest fifth, which can't be seen on a
# dark ground. Colours between are interpolated.
RAMP = (
    "#414487", "#3b528b", "#355f8d", "#2f6c8e", "#2a788e", "#25848e", "#21918c", "#1e9c89",
    "#22a884", "#2fb47c", "#44bf70", "#5ec962", "#7ad151", "#9bd93c", "#bddf26", "#dfe318",
    "#fde725",
)  # fmt: skip
RAMP_WORDS = "dark blue over green to yellow"


# Which of the estimates' colours a GNSS fix has, by its status: none that few estimates have.
FIX_STATUS_PLACES = {0: 3, 1: 4, 2: 5}


def rgb(colour: str) -> tuple[int, int, int]:
    """Return the shares of red, green and blue of `#rrggbb`, 0 to 255."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
