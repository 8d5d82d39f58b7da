"""How numbers are written: in the terminal's tables and in a comparison's."""

from __future__ import annotations

import math

_ROUNDING = 1e-9  # of per cent: 100 * 0.29 is 28.999999999999996


def number(value: float) -> str:
    """Return four significant digits, never an exponent for what people measure."""
    if value == 0.0 or abs(value) < 5e-7:
        return "0"
    if abs(value) >= 1000.0:
        return f"{value:.1f}"
    return f"{value:.4g}" if abs(value) >= 1e-3 else f"{value:.6f}"


def number_text(value: float) -> str:
    """Return a number with three decimals, or three significant digits where these say nothing."""
    return f"{value:.3f}" if value == 0.0 or 0.01 <= abs(value) < 1000.0 else f"{value:.3g}"


def coverage_text(share: float) -> str:
    """Return a share as whole per cent, of which 100 means all and 0 nothing."""
    whole = math.floor(100.0 * share + _ROUNDING)
    return f"{min(max(whole, 1 if share > 0.0 else 0), 100)} %"
