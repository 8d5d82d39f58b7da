"""Largest values of the signals in each second of the last minute."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np

from trajeval_ros.watchdog.signals import Signals

_KEPT_S = 60


class SignalHistory:
    """Keeps the largest value of every signal per second, for the latest seconds with values."""

    def __init__(self) -> None:
        """Create it empty."""
        self._seconds: dict[str, deque[tuple[int, float]]] = {}

    def add(self, signals: Signals) -> None:
        """Add new readings."""
        for name, (seconds, values) in signals.items():
            kept = self._seconds.setdefault(name, deque(maxlen=_KEPT_S))
            whole = np.floor(seconds).astype(np.int64)
            cuts = [0, *(np.flatnonzero(np.diff(whole)) + 1).tolist(), len(whole)]
            for begin, end in pairwise(cuts[-_KEPT_S - 2 :] if len(whole) else []):
                second, largest = int(whole[begin]), float(values[begin:end].max())
                if kept and kept[-1][0] == second:
                    largest = max(largest, kept.pop()[1])
                kept.append((second, largest))

    @property
    def latest(self) -> dict[str, float]:
        """The largest value in the latest second, by signal, in its unit."""
        return {name: kept[-1][1] for name, kept in self._seconds.items() if kept}

    @property
    def by_second(self) -> dict[str, list[tuple[int, float]]]:
        """Seconds since the watch started and the largest value in each, by signal."""
        return {name: list(kept) for name, kept in self._seconds.items()}
