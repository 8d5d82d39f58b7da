"""Tests wait for events, and never for time."""

from __future__ import annotations

import time
from collections.abc import Callable

# More than ten times what any event takes on a quiet machine: at the end of a live run, as many
# processes of the lowest priority write results as there are evaluators.
PATIENCE_S = 150.0
LOOK_EVERY_S = 0.02


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until something is so."""
    limit = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < limit, f"waited in vain: {what}"
        time.sleep(LOOK_EVERY_S)
