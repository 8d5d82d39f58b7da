"""The live evaluator of one estimate, at a constant cost per message."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.dropped_counts import NO_STATE, add_counts
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.upright import between_own_axes
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors, absolute_errors
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import (
    AT_GROUNDTRUTH,
    AUTO,
    Association,
    AssociationRule,
)
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.evaluation import meaningful
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.pair_steps import StampedPoses
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.online.dense_pairing import DensePairing
from trajeval_ros.online.live_alignment import LiveAlignment
from trajeval_ros.online.live_consistency import judge_window, window_integrity
from trajeval_ros.online.live_coverage import LiveCompleteness, LiveCoverage
from trajeval_ros.online.live_relative_errors import RelativeEnd, RelativeTracker
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.marker_rows import marker_rows
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.sparse_pairing import SparsePairing
from trajeval_ros.online.state_rows import (
    POSITION,
    QUATERNION,
    VELOCITY,
    WIDTH,
    WIDTH_WITH_COVARIANCE,
    Pairs,
    on_plane,
    states,
    trajectory,
    turned_covariances,
    upright_rows,
    without_orientations,
)
from trajeval_ros.online.window import PairStore

if TYPE_CHECKING:
    from trajeval_ros.consistency.result import Consistency


class OnlineEvaluator:
    """Evaluates states of both streams as they arrive; results are available at any time.

    It associates, aligns and measures as `evaluate` does: counts are equal, statistics agree to
    1e-9. Association `auto` is resolved by the first groundtruth states: without orientations they
    are fixes or points, and the estimate is interpolated at their timestamps.

    Attributes:
        buffer: The pairing of the states.
        groundtruth_up: Up axis of the groundtruth's frame. Set both axes before the first states.
        estimate_up: Up axis of the estimate's frame.

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
        buffer: Pairing | None = None,
    ) -> None:
        """Create an evaluator without states.

        Args:
            settings: The settings; None for the defaults.
            record: Called with all new pairs, to store them outside this process.
            record_waypoints: Called with the groundtruth's waypoints between pairs.
            buffer: Pairing with the first states, which another evaluator has cut off.
        """
        self.settings = settings or OnlineSettings()
        rule = self.settings.protocol.association
        self._offset = round(rule.time_offset_s * NANOSECONDS)
        self.groundtruth_up = self.estimate_up = Z_UP
        if self.settings.up is not None:
            self.groundtruth_up, self.estimate_up = map(UpAxis, self.settings.up)
        lever_m = self.settings.protocol.lever_m
        self._arm = None if lever_m is None else HandEye.of(None, np.array(lever_m))
        self._record, self._record_waypoints = record, record_waypoints
        kind = SparsePairing if rule.method == AT_GROUNDTRUTH else DensePairing
        self._pair_by(buffer or kind(rule.max_gap_s, self.settings.limits))
        self._is_settled = buffer is not None or rule.method != AUTO
        covariances = self.settings.covariances.source != "none"
        self.store = PairStore(covariances=covariances)
        self._begin_to_align()
        self._count = self._late = 0

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take new groundtruth states.

        Args:
            stamps: (N,) int64, nanoseconds.
            rows: (N, 3) positions, metres; (N, 7) positions and quaternions xyzw; or (N, 10) of
                `state_rows.states`, with velocities. Estimates can have (N, 46), with covariances.

        Raises:
            InputError: The rows have another number of columns.
        """
        rows = _all_columns(rows)[:, :WIDTH]
        if self._arm is not None:
            rows = without_orientations(rows)  # of a point, also if messages have a constant one
        if not self._is_settled:
            self._settle(rows)
        rows = on_plane(rows, self.groundtruth_up) if self._is_planar else rows
        self.buffer.add_groundtruth(stamps, rows)

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take new estimated states; see `add_groundtruth`.

        Raises:
            InputError: The protocol has a lever arm, and the states have no orientations.
        """
        rows = _all_columns(rows)
        if self._arm is not None and np.isnan(rows[:, QUATERNION.start]).any():
            raise InputError(
                "the estimate has no orientations, so no lever arm can be applied to it"
            )
        self.buffer.add_estimate(stamps + self._offset, rows)

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate the states since the last call.

        Args:
            at_end: No more groundtruth will come.
        """
        pairs = self.of_same_point(self.buffer.made(at_end=at_end))
        self.buffer.settle()
        return self.evaluate(pairs, at_end=at_end)

    def of_same_point(self, pairs: Pairs) -> Pairs:
        """Return pairs of the pairing for the groundtruth's point, in the plane if planar.

        The lever arm depends on the orientation at the pair's timestamp. Therefore it is applied
        after the interpolation of the estimate, and before the projection.
        """
        estimate = pairs.estimate
        if self._arm is not None:
            estimate = marker_rows(estimate, self._arm, self.settings.covariances.rotation_frame)
        if self._is_planar:
            estimate = on_plane(estimate, self.estimate_up)
        return pairs._replace(estimate=estimate)

    def evaluate(self, pairs: Pairs, *, at_end: bool = False) -> Update:
        """Evaluate new pairs, already converted by `of_same_point`; see `update`."""
        if len(pairs.stamps):
            if self._record is not None:
                self._record(pairs)
            self._count += len(pairs.stamps)
            pairs = self._in_order(pairs)
        self._coverage.add(pairs, at_end=at_end)
        if not len(pairs.stamps):
            return Update()
        own = pairs
        if self.settings.covariances.rotation_frame == "body":
            pairs = pairs._replace(estimate=turned_covariances(pairs.estimate))
        if self._is_upright:
            pairs = Pairs(
                pairs.stamps,
                upright_rows(pairs.groundtruth, self.groundtruth_up),
                upright_rows(pairs.estimate, self.estimate_up),
            )
        self.store.append(pairs)
        self._aligning.add(pairs)
        ends: tuple[RelativeEnd, ...] = ()
        if not np.isnan(pairs.groundtruth[0, 3] + pairs.estimate[0, 3]):
            scale = 1.0 if self._aligning.found is None else self._aligning.found.similarity.scale
            ends = self._relative.update(self.store, scale)
        window_begin = self.store.window_begin(self.settings.window)
        self.store.drop_before(min(window_begin, self._relative.oldest_needed(self.store)))
        return Update(len(pairs.stamps), int(pairs.stamps[-1]), self._errors_of(own), ends)

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, at a cost proportional to the window's length."""
        begin = self.store.window_begin(self.settings.window)
        consistency, why_not = self._consistency(begin)
        return Snapshot(
            pairs=self._count,
            warming_up=self._aligning.why_not,
            alignment=self.alignment,
            position_rmse_m=self._aligning.rmse(self._aligning.whole),
            window_position_rmse_m=self._aligning.rmse(self._window_moments(begin)),
            ate=self._window_statistics(begin),
            window_pairs=self.store.end - begin,
            relative=self._relative.running,
            estimate_coverage=self._estimate_coverage(),
            coverage=self._coverage.coverage(),
            dropped=add_counts(self.buffer.dropped, {"out_of_order": self._late}),
            waiting=self.buffer.waiting,
            consistency=consistency,
            why_not_consistency=why_not,
            integrity=window_integrity(
                consistency, self.settings.integrity, self.store.stamps(begin)
            ),
        )

    @property
    def offset_s(self) -> float:
        """Offset added to the estimate's timestamps, seconds."""
        return self.settings.protocol.association.time_offset_s

    def leaves_out_velocities_of(self, rows: Floats) -> bool:
        """Return whether states have velocities that are not evaluated because of a lever arm."""
        if self._arm is None or not self._arm.lever_m.any():
            return False
        return bool(np.nan_to_num(rows[:, VELOCITY]).any())

    @property
    def rule(self) -> AssociationRule:
        """Rule of the association, with `auto` as resolved so far."""
        kind = "points" if isinstance(self.buffer, SparsePairing) else "poses"
        return self.settings.protocol.association.for_kind(kind)

    @property
    def pairs(self) -> int:
        """Number of pairs so far."""
        return self._count

    @property
    def alignment(self) -> Alignment | None:
        """The present alignment, between the frames' own axes; None before the first one."""
        if self._aligning.found is None or not self._is_upright:
            return self._aligning.found
        axes = self.groundtruth_up, self.estimate_up
        similarity = between_own_axes(self._aligning.found.similarity, *axes)
        return dataclasses.replace(self._aligning.found, similarity=similarity)

    @property
    def frozen_at(self) -> int | None:
        """Number of states of the frozen alignment; None while it is not frozen."""
        if not (self.settings.freeze and self._aligning.is_kept) or self._aligning.found is None:
            return None
        return self._aligning.found.states_used

    def set_gauge(self, gauge: Gauge) -> None:
        """Change the gauge; call it before the first groundtruth."""
        self.settings = self.settings.with_gauge(gauge)
        self._begin_to_align()

    def judge_moved_groundtruth(self, hand_eye: HandEye) -> None:
        """Judge covariances from now on by groundtruth moved from a marker to the body."""
        covariances = self.settings.covariances.of_moved_groundtruth(hand_eye)
        self.settings = dataclasses.replace(self.settings, covariances=covariances)

    def _begin_to_align(self) -> None:
        """Reset the alignment and the relative errors."""
        protocol = self.settings.protocol
        self._is_planar = protocol.gauge is Gauge.PLANAR
        self._is_upright = protocol.gauge.turns_about_gravity_only
        self._relative = RelativeTracker(protocol)
        self._aligning = LiveAlignment(protocol, freezes=self.settings.freeze)

    def change(self, settings: OnlineSettings) -> None:
        """Use other lengths and another window from now on; other settings are kept.

        A larger window fills with new pairs. A new length starts at the next pair.
        """
        protocol = dataclasses.replace(self.settings.protocol, lengths=settings.protocol.lengths)
        self.settings = dataclasses.replace(
            self.settings, protocol=protocol, window=settings.window
        )
        self._relative = self._relative.with_lengths(protocol, self.store.end)

    def set_offset(self, offset_s: float) -> None:
        """Set the offset of the estimate's timestamps, seconds; call it before the first state."""
        protocol = self.settings.protocol
        rule = dataclasses.replace(protocol.association, time_offset_s=offset_s)
        protocol = dataclasses.replace(protocol, association=rule)
        self.settings = dataclasses.replace(self.settings, protocol=protocol)
        self._offset = round(offset_s * NANOSECONDS)

    def association(self) -> Association:
        """Return all pairs for an offline evaluation; needs a window of the whole run.

        Pairs of gauges yaw and planar are in frames with z up.

        Raises:
            SettingsError: The window is shorter, so that pairs have been dropped.
        """
        if not self.settings.window.is_whole_run:
            raise SettingsError(
                "all pairs are available only with a window of the whole run; set window 0"
            )
        return dataclasses.replace(
            self._pairs_from(self.store.begin),
            estimate_coverage=self._estimate_coverage(),
            coverage=self._coverage.coverage() or Coverage(0.0, 0.0),
            dropped=add_counts(self.buffer.dropped, {"out_of_order": self._late}),
        )

    def _pairs_from(self, begin: int) -> Association:
        """Return the pairs from number `begin` on, at least one, without counts."""
        stamps = self.store.stamps(begin)
        return Association(
            rule=self.rule,
            groundtruth=trajectory(stamps, self.store.groundtruth(begin), self._vertical),
            estimate=trajectory(stamps, self.store.estimate(begin)),
            estimate_coverage=0.0,
            coverage=Coverage(0.0, 0.0),
            dropped={},
            from_the_start=isinstance(self.buffer, SparsePairing)
            or bool(stamps[0] == self.buffer.estimate_intake.first),
        )

    def _consistency(self, begin: int) -> tuple[Consistency | None, str]:
        """Return the consistency test of the pairs from `begin` on, or why there is none."""
        if self.settings.covariances.source == "none":
            return None, ""
        if not len(self.store):
            return None, "no pairs yet"
        protocol, request = self.settings.protocol, self.settings.covariances
        return judge_window(self._pairs_from(begin), protocol, request.once_turned)

    def _settle(self, rows: Floats) -> None:
        """Resolve association `auto` by the first usable groundtruth states, if there are any."""
        usable = np.flatnonzero(np.isfinite(rows[:, POSITION]).all(axis=1))
        if not len(usable):
            return
        self._is_settled = True
        if np.isnan(rows[usable[0], QUATERNION.start]):
            self._pair_by(SparsePairing.after(self.buffer))

    def _pair_by(self, buffer: Pairing) -> None:
        """Use a pairing, and measure its coverage."""
        self.buffer = buffer
        of_kind = LiveCompleteness if isinstance(buffer, SparsePairing) else LiveCoverage
        self._coverage: LiveCompleteness | LiveCoverage = of_kind(buffer, self._record_waypoints)

    @property
    def _vertical(self) -> UpAxis:
        """The up axis of the groundtruth in the store."""
        return Z_UP if self._is_upright else self.groundtruth_up

    def _in_order(self, pairs: Pairs) -> Pairs:
        """Drop pairs older than the newest one; the recording keeps them."""
        if not len(self.store) or pairs.stamps[0] > self.store.stamps()[-1]:
            return pairs
        new = pairs.stamps > self.store.stamps()[-1]
        self._late += int(np.count_nonzero(~new))
        return pairs.picked(new)

    def _window_moments(self, begin: int) -> Moments:
        """Return the moments of the pairs from `begin` on."""
        if self.settings.window.is_whole_run or not len(self.store):
            return self._aligning.whole
        pairs = self.store.groundtruth(begin), self.store.estimate(begin)
        return self._aligning.moments(*pairs, self._aligning.whole.anchor)

    def _errors(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> AbsoluteErrors:
        """Return the errors of stored pairs (N,), (N, 10), (N, 10) under the present alignment."""
        assert self._aligning.found is not None
        alignment, protocol = self._aligning.found, self.settings.protocol
        aligned = alignment.similarity.trajectory(trajectory(stamps, estimate))
        errors = absolute_errors(
            trajectory(stamps, groundtruth, self._vertical),
            aligned,
            rotation=not alignment.why_withheld(protocol),
        )
        return meaningful(errors, alignment, protocol.gauge)

    def _errors_of(self, pairs: Pairs) -> tuple[PairErrors, ...]:
        """Return errors of pairs between the frames' own axes under the present alignment."""
        alignment = self.alignment
        if alignment is None:
            return ()
        rotation = not alignment.why_withheld(self.settings.protocol)
        return (PairErrors(pairs, alignment.similarity, self.groundtruth_up, rotation=rotation),)

    def _window_statistics(self, begin: int) -> dict[str, Statistics | None]:
        if self._aligning.found is None or not len(self.store):
            return {}
        errors = self._errors(
            self.store.stamps(begin), self.store.groundtruth(begin), self.store.estimate(begin)
        )
        return {
            name: statistics_of(getattr(errors, name)) for name in AbsoluteErrors.__annotations__
        }

    def _estimate_coverage(self) -> float | None:
        """Return the share of estimated states in a pair; None for pairs at fixes and points."""
        if isinstance(self.buffer, SparsePairing):
            return None
        dropped = self.buffer.dropped.items()
        states = self._count + sum(count for reason, count in dropped if reason not in NO_STATE)
        return self._count / states if states else None


def _all_columns(rows: Floats) -> Floats:
    """Return rows (N, 10), from positions (N, 3) or positions and quaternions (N, 7)."""
    if rows.ndim == 2 and rows.shape[1] in (WIDTH, WIDTH_WITH_COVARIANCE):
        return rows
    if rows.ndim != 2 or rows.shape[1] not in (3, 7):
        raise InputError(
            f"states are rows of 3, 7, {WIDTH} or {WIDTH_WITH_COVARIANCE} columns (position, "
            f"quaternion xyzw, velocity, covariance), not an array of shape {rows.shape}"
        )
    return states(rows[:, POSITION], rows[:, QUATERNION] if rows.shape[1] == 7 else None)
