"""The window of the live statistics: its pairs, and their results as for a recorded run."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest, IntegrityRequest
from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.travelled import step_lengths
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors, absolute_errors
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.metrics.premises import Doubts
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.state_buffer import Tail

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

    Pairs are numbered in order of time from the start of the run; `begin` is the oldest stored
    one. A late pair moves the numbers of newer ones. A pair takes 184 bytes, and 288 more with
    covariances. The arrays double when they are full. Allocated memory is up to twice that of the
    pairs; resident memory is that of the pairs, and the double during a reallocation.
    """

    def __init__(self) -> None:
        self._groundtruth, self._estimate = Tail(), Tail()

    def __len__(self) -> int:
        """Return the number of stored pairs."""
        return len(self._estimate)

    @property
    def begin(self) -> int:
        """Number of the oldest stored pair."""
        return self._estimate.dropped

    @property
    def end(self) -> int:
        """Number of the pair after the newest one."""
        return self.begin + len(self)

    @property
    def newest(self) -> int:
        """Timestamp of the newest pair, nanoseconds; the least int64 without pairs."""
        return self._estimate.newest

    def add(self, pairs: PairedStates) -> None:
        """Add pairs in order of time, also late ones; those before the oldest are left out."""
        if self.begin and pairs.stamps[0] < self._estimate.stamps[0]:
            pairs = pairs.part(pairs.stamps > self._estimate.stamps[0])
            if not len(pairs):
                return
        row, _ = self._groundtruth.add(pairs.groundtruth, along=np.zeros(len(pairs)))
        self._estimate.add(pairs.estimate)
        # The path continues from the pair before the first new one.
        first = max(row, 1)
        if first < len(self):
            positions = self._groundtruth.column("positions")[first - 1 :]
            along = self._groundtruth.column("along")[first - 1 :]
            along[1:] = step_lengths(positions)
            np.cumsum(along, out=along)

    def drop_before(self, number: int) -> None:
        """Drop the pairs before a number, but never the newest pair."""
        row = max(min(number - self.begin, len(self) - 1), 0)
        for side in (self._groundtruth, self._estimate):
            side.drop_before(row)

    def stamps(self, begin: int | None = None) -> Stamps:
        """Return timestamps of the pairs from number `begin` on, (N,), nanoseconds."""
        return self._estimate.stamps[self._row(begin) :]

    def along(self, begin: int | None = None) -> Floats:
        """Return the groundtruth path up to the pairs from `begin` on, (N,), metres."""
        along: Floats = self._groundtruth.column("along")[self._row(begin) :]
        return along

    def pairs(self, rows: slice | Indices) -> PairedStates:
        """Return some rows from the oldest pair on: views for a slice, copies for indices."""
        return PairedStates(self._groundtruth.trajectory(rows), self._estimate.trajectory(rows))

    def poses(self, rows: slice) -> tuple[StampedPoses, StampedPoses]:
        """Return copies of the poses of groundtruth and estimate."""
        return self._groundtruth.poses(rows), self._estimate.poses(rows)

    def _row(self, number: int | None) -> int:
        return 0 if number is None else max(number - self.begin, 0)

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
    pairs: Association, alignment: Alignment, doubts: Doubts
) -> dict[str, Statistics | None]:
    """Return statistics of the absolute errors by metric, under the alignment of the run."""
    aligned = alignment.similarity.trajectory(pairs.estimate)
    errors = doubts.without(absolute_errors(pairs.groundtruth, aligned))
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
