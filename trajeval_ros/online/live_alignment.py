"""The alignment of a running evaluation, from sums over pairs, updated with every batch."""

from __future__ import annotations

import dataclasses

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import Alignment, align_first, solve
from trajeval_ros.metrics.moments import Moments, OrientationSum
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.pairing import PairedStates

# Standard deviation of the rotation at which a frozen alignment is taken.
FREEZE_AT_DEG = 1.0


class LiveAlignment:
    """Aligns the pairs so far according to the protocol, at a constant cost."""

    def __init__(self, protocol: Protocol, *, freezes: bool) -> None:
        self._protocol, self._freezes = protocol, freezes
        self.alignment: Alignment | None = None  # the present one; None before the first one
        self.why_not = "no pairs yet"  # or why it is undetermined; else empty
        self.is_kept = False  # whether it no longer changes
        self._origin: tuple[Floats, Floats] | None = None
        self.whole = self._first = Moments.empty(Similarity.identity())
        self._turned = self._first_turned = OrientationSum.empty()
        self._anchored_at = 1

    def add(self, pairs: PairedStates) -> None:
        """Take new pairs (N,), N > 0, and update the alignment.

        Running sums accumulate rounding errors. Therefore coordinates are relative to the first
        pair, and the anchor of the residuals is renewed when the number of pairs has doubled.
        """
        if self._origin is None:
            sides = pairs.groundtruth, pairs.estimate
            self._origin = sides[0].positions[0].copy(), sides[1].positions[0].copy()
        self.whole += self.moments(pairs, self.whole.anchor)
        self._turned += _orientation_sum(pairs)
        if self.alignment is not None and int(self.whole.weight) >= 2 * self._anchored_at:
            anchor = self._shifted(self.alignment.similarity)
            self.whole = self.whole.with_anchor(anchor)
            self._anchored_at = int(self.whole.weight)
        self._align(pairs)

    def moments(self, pairs: PairedStates, anchor: Similarity) -> Moments:
        """Return the moments of pairs relative to the first pair."""
        assert self._origin is not None
        p, q = pairs.groundtruth.positions, pairs.estimate.positions
        return Moments.of_pairs(p - self._origin[0], q - self._origin[1], anchor=anchor)

    def _align(self, pairs: PairedStates) -> None:
        """Update the alignment by all states so far, or by the first ones."""
        protocol, gauge = self._protocol, self._protocol.gauge
        if self.is_kept:
            return
        if protocol.align_states == 1:
            self._align_by_one(pairs)
            return
        moments, orientation_sum = self._sums_to_align_by(pairs)
        if moments.weight < gauge.minimum_states:
            self.why_not = (
                f"{int(moments.weight)} of {counted(gauge.minimum_states, 'state')} for the "
                "alignment"
            )
            return
        oriented = orientation_sum.weight == moments.weight
        if protocol.align_with == "poses" and not oriented:
            self.why_not = "align with poses needs orientations on both sides"
            return
        solution = solve(
            gauge, moments, orientation_sum if oriented else None, align_with=protocol.align_with
        )
        self.why_not = solution.undetermined
        if self._freezes and not self.why_not:
            self._freeze_if_known(solution)
        self.alignment = self._between_frames(solution)

    def _align_by_one(self, pairs: PairedStates) -> None:
        """Align by the first of the pairs (N,), N > 0, for good, if it determines the gauge."""
        groundtruth, estimate = pairs.groundtruth, pairs.estimate
        try:
            self.alignment = align_first(
                self._protocol.gauge,
                groundtruth.positions[0],
                _first_quaternion(groundtruth),
                estimate.positions[0],
                _first_quaternion(estimate),
            )
        except DegenerateGeometryError as error:
            self.why_not = str(error)
        else:
            self.why_not, self.is_kept = "", True

    def _sums_to_align_by(self, pairs: PairedStates) -> tuple[Moments, OrientationSum]:
        """Return the sums over all states, or over the first ones after adding to these."""
        if self._protocol.align_states is None:
            return self.whole, self._turned
        required = self._protocol.align_states - int(self._first.weight)
        first = pairs.part(slice(required))
        self._first += self.moments(first, self._first.anchor)
        self._first_turned += _orientation_sum(first)
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
            similarity=self._shifted(solution.similarity, -1.0),
            by_positions=None if by_positions is None else self._shifted(by_positions, -1.0),
        )

    def _shifted(self, similarity: Similarity, sign: float = 1.0) -> Similarity:
        """Return an alignment of the frames as one of coordinates relative to the first pair.

        With sign -1, the inverse conversion.
        """
        assert self._origin is not None
        p, q = (sign * item for item in self._origin)
        translation = similarity.translation - p + similarity.linear @ q
        return Similarity(similarity.rotation, translation, similarity.scale)

    def rmse(self, moments: Moments) -> float | None:
        """Return the position RMSE of moments; None without an alignment."""
        if self.alignment is None:
            return None
        return moments.rmse(self._shifted(self.alignment.similarity))


def _orientation_sum(pairs: PairedStates) -> OrientationSum:
    """Return the sum over pairs; empty if orientations are missing."""
    groundtruth, other = pairs.groundtruth.quaternions, pairs.estimate.quaternions
    if groundtruth is None or other is None:
        return OrientationSum.empty()
    return OrientationSum.of_pairs(groundtruth, other)


def _first_quaternion(side: Trajectory) -> Floats | None:
    """Return the orientation of the first state (4,); None without one."""
    return None if side.quaternions is None else side.quaternions[0]
