"""The alignment of a running evaluation, from sums over pairs, updated with every batch."""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.metrics.alignment import Alignment, align_first, solve
from trajeval_ros.metrics.moments import Moments, OrientationSum
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.state_rows import POSITION, QUATERNION, Pairs

# Standard deviation of the rotation at which a frozen alignment is taken.
FREEZE_AT_DEG = 1.0


class LiveAlignment:
    """Aligns the pairs so far according to the protocol, at a constant cost."""

    def __init__(self, protocol: Protocol, *, freezes: bool) -> None:
        self._protocol, self._freezes = protocol, freezes
        self.found: Alignment | None = None  # the present alignment; None before the first one
        self.why_not = "no pairs yet"  # or why it is undetermined; else empty
        self.is_kept = False  # whether it no longer changes
        self._origin: tuple[Floats, Floats] | None = None
        self.whole = self._first = Moments.empty(Similarity.identity())
        self._turned = self._first_turned = OrientationSum.empty()
        self._anchored_at = 1

    def add(self, pairs: Pairs) -> None:
        """Take new pairs (N,), N > 0, newer than all before, and update the alignment.

        Running sums accumulate rounding errors. Therefore coordinates are relative to the first
        pair, and the anchor of the residuals is renewed when the number of pairs has doubled.
        """
        if self._origin is None:
            self._origin = (
                pairs.groundtruth[0, POSITION].copy(),
                pairs.estimate[0, POSITION].copy(),
            )
        self.whole += self.moments(pairs.groundtruth, pairs.estimate, self.whole.anchor)
        self._turned += _orientation_sum(pairs.groundtruth, pairs.estimate)
        if self.found is not None and int(self.whole.weight) >= 2 * self._anchored_at:
            anchor = self._shifted(self.found.similarity)
            self.whole = self.whole.with_anchor(anchor)
            self._anchored_at = int(self.whole.weight)
        self._align(pairs)

    def moments(self, groundtruth: Floats, estimate: Floats, anchor: Similarity) -> Moments:
        """Return the moments of pairs of states (N, 10) relative to the first pair."""
        assert self._origin is not None
        p, q = groundtruth[:, POSITION], estimate[:, POSITION]
        return Moments.of_pairs(p - self._origin[0], q - self._origin[1], anchor=anchor)

    def _align(self, pairs: Pairs) -> None:
        """Update the alignment by all states so far, or by the first ones."""
        protocol, gauge = self._protocol, self._protocol.gauge
        if self.is_kept:
            return
        if protocol.align_states == 1:
            self._align_by_one(pairs)
            return
        moments, turned = self._sums_to_align_by(pairs)
        if moments.weight < gauge.minimum_states:
            self.why_not = (
                f"{int(moments.weight)} of {counted(gauge.minimum_states, 'state')} for the "
                "alignment"
            )
            return
        oriented = turned.weight == moments.weight
        if protocol.align_with == "poses" and not oriented:
            self.why_not = "align with poses needs orientations on both sides"
            return
        solution = solve(
            gauge, moments, turned if oriented else None, align_with=protocol.align_with
        )
        self.why_not = solution.undetermined
        if self._freezes and not self.why_not:
            self._freeze_if_known(solution)
        self.found = self._between_frames(solution)

    def _align_by_one(self, pairs: Pairs) -> None:
        """Align by the first of the pairs (N,), N > 0, for good, if it determines the gauge."""
        groundtruth, estimate = pairs.groundtruth[0], pairs.estimate[0]
        try:
            self.found = align_first(
                self._protocol.gauge,
                groundtruth[POSITION],
                _quaternion(groundtruth),
                estimate[POSITION],
                _quaternion(estimate),
            )
        except DegenerateGeometryError as error:
            self.why_not = str(error)
        else:
            self.why_not, self.is_kept = "", True

    def _sums_to_align_by(self, pairs: Pairs) -> tuple[Moments, OrientationSum]:
        """Return the sums over all states, or over the first ones after adding to these."""
        if self._protocol.align_states is None:
            return self.whole, self._turned
        wanted = self._protocol.align_states - int(self._first.weight)
        first = pairs.groundtruth[:wanted], pairs.estimate[:wanted]
        self._first += self.moments(*first, self._first.anchor)
        self._first_turned += _orientation_sum(*first)
        self.is_kept = int(self._first.weight) >= self._protocol.align_states
        return self._first, self._first_turned

    def _freeze_if_known(self, solution: Alignment) -> None:
        """Keep a determined alignment if its rotation is known to `FREEZE_AT_DEG`."""
        std_deg = 0.0 if solution.freedom is None else solution.freedom.std_deg
        if std_deg < FREEZE_AT_DEG:
            self.is_kept = True
        else:
            self.why_not = (
                f"standard deviation of the alignment {std_deg:.1f} deg, frozen at "
                f"{FREEZE_AT_DEG:.0f} deg"
            )

    def _between_frames(self, solution: Alignment) -> Alignment:
        """Return an alignment of coordinates relative to the first pair as one of the frames."""
        if not self._protocol.gauge.has_translation:
            return solution
        by_positions = solution.by_positions
        return dataclasses.replace(
            solution,
            similarity=self._unshifted(solution.similarity),
            by_positions=None if by_positions is None else self._unshifted(by_positions),
        )

    def _unshifted(self, similarity: Similarity) -> Similarity:
        return self._shifted(similarity, -1.0)

    def _shifted(self, similarity: Similarity, sign: float = 1.0) -> Similarity:
        """Return an alignment of the frames as one of coordinates relative to the first pair."""
        assert self._origin is not None
        p, q = (sign * each for each in self._origin)
        translation = similarity.translation - p + similarity.linear @ q
        return Similarity(similarity.rotation, translation, similarity.scale)

    def rmse(self, moments: Moments) -> float | None:
        """Return the position RMSE of moments; None without an alignment."""
        return None if self.found is None else moments.rmse(self._shifted(self.found.similarity))


def _orientation_sum(groundtruth: Floats, estimate: Floats) -> OrientationSum:
    """Return the sum over pairs of rows (N, 10); empty if orientations are missing."""
    groundtruth, other = groundtruth[:, QUATERNION], estimate[:, QUATERNION]
    if np.isnan(groundtruth[:, 0] + other[:, 0]).any():
        return OrientationSum.empty()
    return OrientationSum.of_pairs(lie.normalized(groundtruth), lie.normalized(other))


def _quaternion(row: Floats) -> Floats | None:
    """Return the orientation of a state (10,); None without one."""
    quaternion = row[QUATERNION]
    return None if np.isnan(quaternion[0]) else lie.normalized(quaternion)
