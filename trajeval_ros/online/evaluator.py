"""The live evaluator of one estimate, at a constant cost per message."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError, InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, NO_STATE, add_counts
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.upright import between_own_axes
from trajeval_ros.metrics.alignment import Alignment, align_first, solve
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.errors import AbsoluteErrors, absolute_errors
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.orientation_sum import OrientationSum
from trajeval_ros.metrics.pair_steps import StampedPoses
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.online.live_coverage import LiveCoverage
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import PairingBuffer
from trajeval_ros.online.relative_errors import RelativeEnd, RelativeTracker
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.state_rows import (
    POSITION,
    QUATERNION,
    WIDTH,
    Pairs,
    on_plane,
    states,
    trajectory,
    upright_rows,
)
from trajeval_ros.online.window import PairStore

# A frozen alignment is taken once its rotation is known to so much, as a standard deviation.
FREEZE_AT_DEG = 1.0


class OnlineEvaluator:
    """Feed it states of both streams as they arrive; ask it for errors at any time.

    It pairs, aligns and measures as `evaluate` does with association `linear`: counts are equal,
    statistics agree to 1e-9.

    Attributes:
        groundtruth_up: Which axis points up in the groundtruth's frame. To be set, if at all,
            before its first states, as well as the estimate's.
        estimate_up: Which one does in the estimate's.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import OnlineEvaluator, simulate
        >>> flight, live = simulate(seed=1, duration_s=30.0), OnlineEvaluator()
        >>> for add, side in ((live.add_groundtruth, flight.groundtruth),
        ...                   (live.add_estimate, flight.estimate)):
        ...     add(side.stamps, np.hstack([side.positions, side.quaternions]))
        >>> live.update(at_end=True).pairs == live.snapshot().pairs > 500
        True
    """

    def __init__(
        self,
        settings: OnlineSettings | None = None,
        record: Callable[[Pairs], object] | None = None,
        record_waypoints: Callable[[StampedPoses], object] | None = None,
    ) -> None:
        """Begin.

        Args:
            settings: What to do.
            record: Is given all new pairs, to keep them beyond this process.
            record_waypoints: Is given the groundtruth's waypoints between them, for the same.
        """
        self.settings = settings or OnlineSettings()
        rule = self.settings.protocol.association
        self._offset = round(rule.time_offset_s * NANOSECONDS)
        self._is_planar = self.settings.protocol.gauge is Gauge.PLANAR
        self._is_upright = self.settings.protocol.gauge.turns_about_gravity_only
        self.groundtruth_up = self.estimate_up = Z_UP
        if self.settings.up is not None:
            self.groundtruth_up, self.estimate_up = map(UpAxis, self.settings.up)
        self.buffer = PairingBuffer(rule.max_gap_s, self.settings.limits)
        self.store = PairStore()
        self._record = record
        self._coverage = LiveCoverage(self.buffer, record_waypoints)
        self._relative = RelativeTracker(self.settings.protocol)
        self._origin: tuple[Floats, Floats] | None = None
        self._whole = self._first = Moments.empty(Similarity.identity())
        self._whole_turned = self._first_turned = OrientationSum.empty()
        self._anchored_at = 1
        self._alignment: Alignment | None = None
        self._kept = False
        self._why_not = "no pair yet"
        self._count = self._late = 0

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states that have arrived.

        Args:
            stamps: (N,) int64, nanoseconds.
            rows: (N, 3) positions, metres; (N, 7) positions and quaternions xyzw; or (N, 10) of
                `state_rows.states`, with velocities.
        """
        rows = _all_columns(rows)
        rows = on_plane(rows, self.groundtruth_up) if self._is_planar else rows
        self.buffer.add_groundtruth(stamps, rows)

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take estimated states that have arrived, as `add_groundtruth` does."""
        rows = _all_columns(rows)
        rows = on_plane(rows, self.estimate_up) if self._is_planar else rows
        self.buffer.add_estimate(stamps + self._offset, rows)

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate what has arrived since the last call.

        Args:
            at_end: No more groundtruth will come.
        """
        pairs = self.buffer.take(at_end=at_end)
        if len(pairs.stamps):
            if self._record is not None:
                self._record(pairs)
            self._count += len(pairs.stamps)
            pairs = self._in_order(pairs)
        self._coverage.add(pairs, at_end=at_end)
        if not len(pairs.stamps):
            return Update()
        own = pairs
        if self._is_upright:
            pairs = Pairs(
                pairs.stamps,
                upright_rows(pairs.groundtruth, self.groundtruth_up),
                upright_rows(pairs.estimate, self.estimate_up),
            )
        self.store.append(pairs)
        self._sum(pairs)
        self._align(pairs)
        ends: tuple[RelativeEnd, ...] = ()
        if not np.isnan(pairs.groundtruth[0, 3] + pairs.estimate[0, 3]):
            scale = 1.0 if self._alignment is None else self._alignment.similarity.scale
            ends = self._relative.update(self.store, scale)
        window_begin = self.store.window_begin(self.settings.window)
        self.store.drop_before(min(window_begin, self._relative.oldest_needed(self.store)))
        return Update(len(pairs.stamps), int(pairs.stamps[-1]), self._errors_of(own), ends)

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation; costs as much as the window is long."""
        begin = self.store.window_begin(self.settings.window)
        return Snapshot(
            pairs=self._count,
            warming_up=self._why_not,
            alignment=self.alignment,
            position_rmse_m=self._rmse(self._whole),
            window_position_rmse_m=self._rmse(self._window_moments(begin)),
            ate=self._window_statistics(begin),
            window_pairs=self.store.end - begin,
            relative=self._relative.running,
            estimate_coverage=self._estimate_coverage(),
            coverage=self._coverage.coverage(),
            dropped=add_counts(self.buffer.dropped, {"out_of_order": self._late}),
            waiting=self.buffer.waiting,
        )

    @property
    def offset_s(self) -> float:
        """What is added to the estimate's stamps, seconds."""
        return self.settings.protocol.association.time_offset_s

    @property
    def pairs(self) -> int:
        """Number of pairs so far."""
        return self._count

    @property
    def alignment(self) -> Alignment | None:
        """The present alignment, between the frames' own axes; None while there is none."""
        if self._alignment is None or not self._is_upright:
            return self._alignment
        axes = self.groundtruth_up, self.estimate_up
        similarity = between_own_axes(self._alignment.similarity, *axes)
        return dataclasses.replace(self._alignment, similarity=similarity)

    @property
    def frozen_at(self) -> int | None:
        """Number of states that a frozen alignment is from; None while it isn't frozen."""
        if not (self.settings.freeze and self._kept) or self._alignment is None:
            return None
        return self._alignment.states_used

    def change(self, settings: OnlineSettings) -> None:
        """Take other lengths and another window from now on; other settings stay.

        A wider window fills as pairs come, a new length counts from the next pair.
        """
        protocol = dataclasses.replace(self.settings.protocol, lengths=settings.protocol.lengths)
        self.settings = dataclasses.replace(
            self.settings, protocol=protocol, window=settings.window
        )
        self._relative = self._relative.with_lengths(protocol, self.store.end)

    def set_offset(self, offset_s: float) -> None:
        """Add so many seconds to the estimate's stamps; before the first of them."""
        protocol = self.settings.protocol
        rule = dataclasses.replace(protocol.association, time_offset_s=offset_s)
        protocol = dataclasses.replace(protocol, association=rule)
        self.settings = dataclasses.replace(self.settings, protocol=protocol)
        self._offset = round(offset_s * NANOSECONDS)

    def association(self) -> Association:
        """Return all pairs, to be evaluated offline; only of a window that is the whole run.

        Those of gauges yaw and planar are in worlds whose z axis is up.

        Raises:
            SettingsError: The window is shorter, so that pairs have been forgotten.
        """
        if not self.settings.window.is_whole_run:
            raise SettingsError("only a window of the whole run keeps all pairs in memory")
        stamps = self.store.stamps()
        dropped = add_counts(self.buffer.dropped, {"out_of_order": self._late})
        return Association(
            rule=self.settings.protocol.association,
            groundtruth=trajectory(stamps, self.store.groundtruth(), self._vertical),
            estimate=trajectory(stamps, self.store.estimate()),
            estimate_coverage=self._estimate_coverage() or 0.0,
            coverage=self._coverage.coverage() or Coverage(0.0, 0.0),
            dropped=dropped,
        )

    @property
    def _vertical(self) -> UpAxis:
        """The up axis of the groundtruth as it is in the store."""
        return Z_UP if self._is_upright else self.groundtruth_up

    def _in_order(self, pairs: Pairs) -> Pairs:
        """Leave out pairs older than the newest one; the record has them."""
        if not len(self.store) or pairs.stamps[0] > self.store.stamps()[-1]:
            return pairs
        new = pairs.stamps > self.store.stamps()[-1]
        self._late += int(np.count_nonzero(~new))
        return Pairs(pairs.stamps[new], pairs.groundtruth[new], pairs.estimate[new])

    def _sum(self, pairs: Pairs) -> None:
        """Add the new pairs to the moments of the run.

        Running sums drift by rounding. Coordinates are taken from the first pair's, residuals
        under an anchor that is renewed when the number of pairs has doubled.
        """
        if self._origin is None:
            self._origin = (
                pairs.groundtruth[0, POSITION].copy(),
                pairs.estimate[0, POSITION].copy(),
            )
        self._whole += self._moments(pairs.groundtruth, pairs.estimate, self._whole.anchor)
        self._whole_turned += _orientation_sum(pairs.groundtruth, pairs.estimate)
        if self._alignment is not None and self._count >= 2 * self._anchored_at:
            anchor = self._shifted(self._alignment.similarity)
            self._whole = self._whole.with_anchor(anchor)
            self._anchored_at = self._count

    def _moments(self, groundtruth: Floats, estimate: Floats, anchor: Similarity) -> Moments:
        assert self._origin is not None
        p, q = groundtruth[:, POSITION], estimate[:, POSITION]
        return Moments.of_pairs(p - self._origin[0], q - self._origin[1], anchor=anchor)

    def _align(self, pairs: Pairs) -> None:
        """Renew the alignment: from all states so far, the first ones, or once for all."""
        protocol, gauge = self.settings.protocol, self.settings.protocol.gauge
        if self._kept:
            return
        if protocol.align_states == 1:
            truth, estimate = pairs.groundtruth[0], pairs.estimate[0]
            try:
                self._alignment = align_first(
                    gauge,
                    truth[POSITION],
                    _quaternion(truth),
                    estimate[POSITION],
                    _quaternion(estimate),
                )
            except DegenerateGeometryError as error:
                self._why_not = str(error)
            else:
                self._why_not, self._kept = "", True
            return
        moments, turned = self._whole, self._whole_turned
        if protocol.align_states is not None:
            wanted = protocol.align_states - int(self._first.weight)
            first = pairs.groundtruth[:wanted], pairs.estimate[:wanted]
            self._first += self._moments(*first, self._first.anchor)
            self._first_turned += _orientation_sum(*first)
            moments, turned = self._first, self._first_turned
            self._kept = int(moments.weight) >= protocol.align_states
        if moments.weight < gauge.minimum_states:
            self._why_not = f"{int(moments.weight)} of {gauge.minimum_states} states to align by"
            return
        oriented = turned.weight == moments.weight
        if protocol.align_with == "poses" and not oriented:
            self._why_not = "align with poses needs orientations on both sides"
            return
        found = solve(gauge, moments, turned if oriented else None, align_with=protocol.align_with)
        self._why_not = found.undetermined
        if self.settings.freeze and not self._why_not:
            open_deg = 0.0 if found.freedom is None else found.freedom.std_deg
            if open_deg < FREEZE_AT_DEG:
                self._kept = True
            else:
                self._why_not = (
                    f"the alignment is still open by {open_deg:.1f} deg; it is frozen at "
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
        self._alignment = found

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

    def _window_moments(self, begin: int) -> Moments:
        if self.settings.window.is_whole_run or not len(self.store):
            return self._whole
        pairs = self.store.groundtruth(begin), self.store.estimate(begin)
        return self._moments(*pairs, self._whole.anchor)

    def _rmse(self, moments: Moments) -> float | None:
        if self._alignment is None:
            return None
        return moments.rmse(self._shifted(self._alignment.similarity))

    def _errors(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> AbsoluteErrors:
        assert self._alignment is not None
        aligned = self._alignment.similarity.trajectory(trajectory(stamps, estimate))
        return absolute_errors(
            trajectory(stamps, groundtruth, self._vertical),
            aligned,
            rotation=not self._alignment.why_withheld(self.settings.protocol),
        )

    def _errors_of(self, pairs: Pairs) -> tuple[PairErrors, ...]:
        """Return the errors of pairs between the frames' own axes, under the present alignment."""
        alignment = self.alignment
        if alignment is None:
            return ()
        rotation = not alignment.why_withheld(self.settings.protocol)
        return (PairErrors(pairs, alignment.similarity, self.groundtruth_up, rotation=rotation),)

    def _window_statistics(self, begin: int) -> dict[str, Statistics | None]:
        if self._alignment is None or not len(self.store):
            return {}
        errors = self._errors(
            self.store.stamps(begin), self.store.groundtruth(begin), self.store.estimate(begin)
        )
        return {
            name: statistics_of(getattr(errors, name)) for name in AbsoluteErrors.__annotations__
        }

    def _estimate_coverage(self) -> float | None:
        dropped = self.buffer.dropped.items()
        states = self._count + sum(count for reason, count in dropped if reason not in NO_STATE)
        return self._count / states if states else None


def _all_columns(rows: Floats) -> Floats:
    """Return rows (N, 10) of positions (N, 3), or of positions and quaternions (N, 7)."""
    if rows.ndim == 2 and rows.shape[1] == WIDTH:
        return rows
    if rows.ndim != 2 or rows.shape[1] not in (3, 7):
        raise InputError(
            f"states are rows of 3, 7 or {WIDTH} columns (position, quaternion xyzw, velocity), "
            f"not an array of shape {rows.shape}"
        )
    return states(rows[:, POSITION], rows[:, QUATERNION] if rows.shape[1] == 7 else None)


def _orientation_sum(groundtruth: Floats, estimate: Floats) -> OrientationSum:
    """Return the sum over pairs of rows (N, 10); the empty one where orientations lack."""
    truth, other = groundtruth[:, QUATERNION], estimate[:, QUATERNION]
    if np.isnan(truth[:, 0] + other[:, 0]).any():
        return OrientationSum.empty()
    return OrientationSum.of_pairs(lie.normalized(truth), lie.normalized(other))


def _quaternion(row: Floats) -> Floats | None:
    quaternion = row[QUATERNION]
    return None if np.isnan(quaternion[0]) else lie.normalized(quaternion)
