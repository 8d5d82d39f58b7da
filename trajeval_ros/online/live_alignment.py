"""The alignment of a run as it goes on: from sums over pairs, renewed with each batch of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.metrics.alignment import Alignment, align_first, solve
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.orientation_sum import OrientationSum
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.state_rows import POSITION, QUATERNION, Pairs

# A frozen alignment is taken once its rotation is known to so much, as a standard deviation.
FREEZE_AT_DEG = 1.0


class LiveAlignment:
    """Aligns by the pairs so far, as the protocol says, at a constant cost.

    Attributes:
        found: The present alignment; None while there is none.
        why_not: Why there is none yet, or what leaves it open; empty if nothing does.
        is_kept: Whether it stays as it is.
        whole: Moments of all pairs.
    """

    def __init__(self, protocol: Protocol, *, freezes: bool) -> None:
        """Create it without a pair.

        Args:
            protocol: Gauge, and the states to align by.
            freezes: Keep the first alignment that the states determine well.
        """
        self._protocol, self._freezes = protocol, freezes
        self.found: Alignment | None = None
        self.why_not, self.is_kept = "no pairs yet", False
        self._origin: tuple[Floats, Floats] | None = None
        self.whole = self._first = Moments.empty(Similarity.identity())
        self._turned = self._first_turned = OrientationSum.empty()
        self._anchored_at = 1

    def add(self, pairs: Pairs) -> None:
        """Take new pairs, (N,), N > 0, that are newer than all before, and align anew.

        Running sums drift by rounding. Coordinates are taken from the first pair's, residuals
        under an anchor that is renewed when the number of pairs has doubled.
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
        """Return the moments of pairs of states (N, 10), under an anchor, from the origin."""
        assert self._origin is not None
        p, q = groundtruth[:, POSITION], estimate[:, POSITION]
        return Moments.of_pairs(p - self._origin[0], q - self._origin[1], anchor=anchor)

    def _align(self, pairs: Pairs) -> None:
        """Renew the alignment: from all states so far, the first ones, or once for all."""
        protocol, gauge = self._protocol, self._protocol.gauge
        if self.is_kept:
            return
        if protocol.align_states == 1:
            truth, estimate = pairs.groundtruth[0], pairs.estimate[0]
            try:
                self.found = align_first(
                    gauge,
                    truth[POSITION],
                    _quaternion(truth),
                    estimate[POSITION],
                    _quaternion(estimate),
                )
            except DegenerateGeometryError as error:
                self.why_not = str(error)
            else:
                self.why_not, self.is_kept = "", True
            return
        moments, turned = self.whole, self._turned
        if protocol.align_states is not None:
            wanted = protocol.align_states - int(self._first.weight)
            first = pairs.groundtruth[:wanted], pairs.estimate[:wanted]
            self._first += self.moments(*first, self._first.anchor)
            self._first_turned += _orientation_sum(*first)
            moments, turned = self._first, self._first_turned
            self.is_kept = int(moments.weight) >= protocol.align_states
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
        found = solve(gauge, moments, turned if oriented else None, align_with=protocol.align_with)
        self.why_not = found.undetermined
        if self._freezes and not self.why_not:
            open_deg = 0.0 if found.freedom is None else found.freedom.std_deg
            if open_deg < FREEZE_AT_DEG:
                self.is_kept = True
            else:
                self.why_not = (
                    f"standard deviation of the alignment {open_deg:.1f} deg, frozen at "
                    f"{FREEZE_AT_DEG:.0f} deg"
                )
        if gauge.has_translation:
            found = dataclasses.replace(
                found,
                similarity=self._unshifted(found.similarity),
                by_positions=None
                if found.by_positions is None
                else self._unshifted(found.by_positions),
            )
        self.found = found

    def _unshifted(self, similarity: Similarity) -> Similarity:
        """Return an alignment of coordinates from the origin as one of the frames' own."""
        assert self._origin is not None
        p, q = self._origin
        translation = similarity.translation + p - similarity.linear @ q
        return Similarity(similarity.rotation, translation, similarity.scale)

    def _shifted(self, similarity: Similarity) -> Similarity:
        """Return an alignment of the frames' own coordinates as one of those from the origin."""
        assert self._origin is not None
        p, q = self._origin
        translation = similarity.translation - p + similarity.linear @ q
        return Similarity(similarity.rotation, translation, similarity.scale)

    def rmse(self, moments: Moments) -> float | None:
        """Return the position error of moments from the origin; None without an alignment."""
        return None if self.found is None else moments.rmse(self._shifted(self.found.similarity))


def _orientation_sum(groundtruth: Floats, estimate: Floats) -> OrientationSum:
    """Return the sum over pairs of rows (N, 10); the empty one where orientations lack."""
    truth, other = groundtruth[:, QUATERNION], estimate[:, QUATERNION]
    if np.isnan(truth[:, 0] + other[:, 0]).any():
        return OrientationSum.empty()
    return OrientationSum.of_pairs(lie.normalized(truth), lie.normalized(other))


def _quaternion(row: Floats) -> Floats | None:
    quaternion = row[QUATERNION]
    return None if np.isnan(quaternion[0]) else lie.normalized(quaternion)
