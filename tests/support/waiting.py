"""Tests wait for events, and never for time."""

from __future__ import annotations

import time
from collections.abc import Callable

# Far more than what any event takes, also for processes of the lowest priority on a busy machine.
# It matters only for a test that fails.
PATIENCE_S = 600.0
LOOK_EVERY_S = 0.02


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until something is so."""
    limit = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < limit, f"waited in vain: {what}"
        time.sleep(LOOK_EVERY_S)
