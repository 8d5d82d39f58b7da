"""The colours of figures, reports and Rerun: one palette and one colour ramp."""

from __future__ import annotations

# Okabe and Ito's colours, distinguishable for the colour-blind, without the bright yellow. The
# first one is not on the ramp, so that an estimate differs from a path coloured by error.
ESTIMATES = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
# Lighter variants for a dark background.
ESTIMATES_ON_DARK = ("#ff8f47", "#4da6dd", "#35c79a", "#e3a1c6", "#f0b942", "#8accf3")

# matplotlib's viridis (CC0) in equal steps, without its darkest fifth, which is invisible on a
# dark background. Colours between the steps are interpolated.
RAMP = (
    "#414487", "#3b528b", "#355f8d", "#2f6c8e", "#2a788e", "#25848e", "#21918c", "#1e9c89",
    "#22a884", "#2fb47c", "#44bf70", "#5ec962", "#7ad151", "#9bd93c", "#bddf26", "#dfe318",
    "#fde725",
)  # fmt: skip
RAMP_WORDS = "dark blue over green to yellow"


# Colours of GNSS fixes by status, as positions in `ESTIMATES`; late ones, which few estimates use.
FIX_STATUS_PLACES = {0: 3, 1: 4, 2: 5}


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
