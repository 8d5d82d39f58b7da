"""The window of the live statistics: its pairs, and their results as for a recorded run."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest, IntegrityRequest
from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors, absolute_errors, lengths
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.metrics.withholding import doubts_of
from trajeval_ros.online.state_buffer import StateBuffer
from trajeval_ros.online.state_rows import POSITION, WIDTH, WIDTH_WITH_COVARIANCE, Pairs, as_wide

if TYPE_CHECKING:
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity


_LARGEST = 1e9  # s, m or pairs; int64 nanoseconds hold it


@dataclass(frozen=True)
class Window:
    """The newest part of a run, by time, distance or number of pairs; or the whole run."""

    size: float = 0.0  # its size in its unit; 0 is the whole run
    unit: str = "pairs"  # `s`, `m`, or `pairs`

    @classmethod
    def parse(cls, text: str) -> Window:
        """Parse "0" (the whole run), "30s", "50m" or "500" (pairs).

        Raises:
            SettingsError: The text is not valid, or the window is too long.
        """
        match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(s|m)?\s*", text)
        if match is None:
            raise SettingsError(
                f"the window {text!r} is not valid; give 0 (whole run), 30s, 50m or 500 (pairs)"
            )
        size = float(match[1])
        if size > _LARGEST:
            raise SettingsError(
                f"the window {text.strip()} is above the limit of {_LARGEST:g}; use 0 for the "
                "whole run"
            )
        return cls(size, match[2] or "pairs")

    def __str__(self) -> str:
        """Return the text that `parse` accepts."""
        return f"{self.size:.15g}{'' if self.unit == 'pairs' else self.unit}"

    @property
    def is_whole_run(self) -> bool:
        """Whether it is the whole run."""
        return self.size == 0.0


class PairStore:
    """The newest pairs as columns, with the groundtruth path up to every pair.

    Pairs are numbered from the start of the run; `begin` is the oldest stored one. A pair takes
    176 bytes, and 288 more with covariances. The arrays double when they are full. Allocated
    memory is up to twice that of the pairs; resident memory is that of the pairs, and the double
    during a reallocation.
    """

    def __init__(self, *, covariances: bool = False) -> None:
        self.begin = self.end = 0
        # Columns: groundtruth, estimate, path. The pair before the oldest is kept, because the
        # path continues from it.
        self._own_width = WIDTH_WITH_COVARIANCE if covariances else WIDTH
        self._pairs = StateBuffer(WIDTH + self._own_width + 1)

    def __len__(self) -> int:
        """Return the number of stored pairs."""
        return self.end - self.begin

    def append(self, pairs: Pairs) -> None:
        """Add pairs; the path continues from the last groundtruth position."""
        before = self._pairs.held[1][-1:]
        path = np.concatenate([before[:, POSITION], pairs.groundtruth[:, POSITION]])
        along = np.zeros((len(pairs.stamps), 1))
        along[1 - len(before) :, 0] = before[:, -1].sum() + np.cumsum(
            lengths(np.diff(path, axis=0))
        )
        estimate = as_wide(pairs.estimate, self._own_width)
        self._pairs.append(pairs.stamps, np.hstack([pairs.groundtruth, estimate, along]))
        self.end += len(pairs.stamps)

    def drop_before(self, number: int) -> None:
        """Drop the pairs before a number."""
        self.begin = min(max(self.begin, number), self.end)
        self._pairs.drop(max(len(self._pairs) - len(self) - 1, 0))

    def _view(self, begin: int | None) -> slice:
        first = self.begin if begin is None else max(begin, self.begin)
        return slice(len(self._pairs) - self.end + first, None)

    def stamps(self, begin: int | None = None) -> Stamps:
        """Return timestamps of the pairs from number `begin` on, (N,), nanoseconds."""
        return self._pairs.held[0][self._view(begin)]

    def groundtruth(self, begin: int | None = None) -> Floats:
        """Return groundtruth states of the pairs from number `begin` on, (N, 10)."""
        return self._pairs.held[1][self._view(begin), :WIDTH]

    def estimate(self, begin: int | None = None) -> Floats:
        """Return estimated states of the pairs from `begin` on, (N, 10) or (N, 46)."""
        return self._pairs.held[1][self._view(begin), WIDTH:-1]

    def along(self, begin: int | None = None) -> Floats:
        """Return the groundtruth path up to the pairs from `begin` on, (N,), metres."""
        return self._pairs.held[1][self._view(begin), -1]

    def window_begin(self, window: Window) -> int:
        """Return the number of the first pair in a window."""
        if window.is_whole_run or not len(self):
            return self.begin
        if window.unit == "pairs":
            return max(self.begin, self.end - int(window.size))
        if window.unit == "m":
            along = self.along()
            return self.begin + int(along.searchsorted(along[-1] - window.size))
        stamps = self.stamps()
        oldest = stamps[-1] - round(window.size * NANOSECONDS)
        return self.begin + int(stamps.searchsorted(oldest))


def window_statistics(
    pairs: Association, alignment: Alignment, protocol: Protocol
) -> dict[str, Statistics | None]:
    """Return statistics of the absolute errors by metric, under the alignment of the run."""
    errors = absolute_errors(
        pairs.groundtruth,
        alignment.similarity.trajectory(pairs.estimate),
        rotation=not alignment.why_withheld(protocol),
    )
    errors = doubts_of(pairs, alignment, protocol).without(errors)
    return {name: statistics_of(getattr(errors, name)) for name in AbsoluteErrors.__annotations__}


def judge_window(
    pairs: Association | None, protocol: Protocol, request: CovarianceRequest
) -> tuple[Consistency | None, str]:
    """Test the covariances of pairs, aligned on their own; return the reason if not possible."""
    if request.source == "none":
        return None, ""
    if pairs is None:
        return None, "no pairs yet"
    from trajeval_ros.consistency.consistency_assessment import assess_consistency  # imports scipy

    protocol = dataclasses.replace(protocol, lengths=())
    try:
        evaluation = evaluate_pairs(pairs, pairs.groundtruth, pairs.estimate, protocol)
        return assess_consistency(evaluation, request), ""
    except TrajevalError as error:
        return None, str(error)


def window_integrity(
    consistency: Consistency | None, request: IntegrityRequest | None, stamps: Stamps
) -> Integrity | None:
    """Return errors of a window's N pairs against protection levels; None if not available."""
    if consistency is None or request is None:
        return None
    from trajeval_ros.consistency.integrity import integrity_of  # imports scipy

    return integrity_of(consistency, request, stamps)
