"""The live evaluator of one estimate, at a constant cost per message."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from trajeval_ros.consistency.yaw_information import YawInformation
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.valid_poses import NO_STATE, add_counts
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import AT_GROUNDTRUTH, AUTO, Association, AssociationRule
from trajeval_ros.metrics.coverage import Coverage, StampedPoses
from trajeval_ros.metrics.lost_tracking import LostTracking
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.online.dense_pairing import DensePairing, LiveCoverage
from trajeval_ros.online.live_alignment import LiveAlignment
from trajeval_ros.online.live_frames import LiveFrames
from trajeval_ros.online.live_relative_errors import RelativeEnd, RelativeTracker
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.sparse_pairing import LiveCompleteness, SparsePairing
from trajeval_ros.online.state_rows import (
    COVARIANCE,
    POSITION,
    QUATERNION,
    WIDTH,
    Pairs,
    all_columns,
    trajectory,
)
from trajeval_ros.online.window import PairStore, judge_window, window_integrity, window_statistics


class OnlineEvaluator:
    """Evaluates states of both streams as they arrive; results are available at any time.

    It associates, aligns and measures as `evaluate` does: counts are equal, statistics agree to
    1e-9. Association `auto` is resolved by the first groundtruth states: without orientations they
    are fixes or points, and the estimate is interpolated at their timestamps.

    Attributes:
        buffer: The pairing of the states.
        frames: Up axes of both frames, which must be set before the first states, and conversions.
        store: The pairs of the window, and those that relative errors still need.
        tracking: Losses of tracking: frozen and diverging estimates.

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
        """Create an evaluator without states.

        Args:
            settings: The settings; None for the defaults.
            record: Called with all new pairs, to store them outside this process.
            record_waypoints: Called with the groundtruth's waypoints between pairs.
        """
        self.settings = settings or OnlineSettings()
        rule = self.settings.protocol.association
        self.frames = LiveFrames(self.settings)
        self._record, self._record_waypoints = record, record_waypoints
        kind = SparsePairing if rule.method == AT_GROUNDTRUTH else DensePairing
        self._pair_by(kind(rule.max_gap_s, self.settings.limits))
        self._is_settled = rule.method != AUTO
        covariances = self.settings.covariances.source != "none"
        self.store = PairStore(covariances=covariances)
        self._begin_to_align()
        self._count = self._late = 0
        self._yaw = YawInformation()
        self._ate_before_m: float | None = None  # until nothing suggested a loss of tracking

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take new groundtruth states.

        Args:
            stamps: (N,) int64, nanoseconds.
            rows: (N, 3) positions, metres; (N, 7) positions and quaternions xyzw; or (N, 10) of
                `state_rows.states`, with velocities. Estimates can have (N, 46), with covariances.

        Raises:
            InputError: The rows have another number of columns.
        """
        rows = self.frames.of_point(all_columns(rows)[:, :WIDTH])
        if not self._is_settled:
            self._settle(rows)
        self.buffer.add_groundtruth(stamps, self.frames.in_plane(rows))

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take new estimated states; see `add_groundtruth`.

        Raises:
            InputError: The protocol has a lever arm, and the states have no orientations.
        """
        rows = all_columns(rows)
        self.frames.require_orientations(rows)
        self.buffer.add_estimate(stamps + self.settings.offset_ns, rows)

    def continue_after(self, before: OnlineEvaluator) -> None:
        """Take the states that the evaluator of the previous run has received and not used.

        Call it before the first state. The settings must be the same.
        """
        buffer = before.buffer
        self._pair_by(type(buffer)(buffer.max_gap_s, buffer.limits))
        self._is_settled = before._is_settled
        buffer.hand_over(self.buffer)

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate the states since the last call.

        Args:
            at_end: No more groundtruth will come.
        """
        pairs = self.frames.of_same_point(self.buffer.made(at_end=at_end))
        self.buffer.settle()
        return self.evaluate(pairs, at_end=at_end)

    def evaluate(self, pairs: Pairs, *, at_end: bool = False) -> Update:
        """Evaluate new pairs, already converted by `frames.of_same_point`; see `update`."""
        if len(pairs.stamps):
            if self._record is not None:
                self._record(pairs)
            self._count += len(pairs.stamps)
            pairs = self._in_order(pairs)
        self._coverage.add(pairs, at_end=at_end)
        if not len(pairs.stamps):
            return Update(ends=self._ends(at_end=at_end)) if at_end else Update()
        self.tracking.add(pairs.stamps, pairs.groundtruth, pairs.estimate)
        own, pairs = pairs, self.frames.upright(pairs)
        self.store.append(pairs)
        self._aligning.add(pairs)
        self._add_covariances(pairs)
        if self.tracking.is_clear:
            self._ate_before_m = self._aligning.rmse(self._aligning.whole)
        ends = self._ends(at_end=at_end)
        window_begin = self.store.window_begin(self.settings.window)
        self.store.drop_before(min(window_begin, self._relative.oldest_needed(self.store)))
        return Update(len(pairs.stamps), int(pairs.stamps[-1]), self._errors_of(own), ends)

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, at a cost proportional to the window's length."""
        begin = self.store.window_begin(self.settings.window)
        protocol, request = self.settings.protocol, self.settings.covariances
        found = self._aligning.found
        pairs = self._pairs_from(begin) if len(self.store) else None
        ate: dict[str, Statistics | None] = {}
        if pairs is not None and found is not None:
            ate = window_statistics(pairs, found, protocol)
        loss = self.tracking.present
        consistency, why_not = judge_window(pairs, protocol, request.once_turned)
        return Snapshot(
            pairs=self._count - self._late,
            stamp=int(self.store.stamps()[-1]) if len(self.store) else None,
            warming_up=self._aligning.why_not,
            alignment=self.alignment,
            position_rmse_m=self._aligning.rmse(self._aligning.whole),
            window_position_rmse_m=self._aligning.rmse(self._window_moments(begin)),
            ate=ate,
            window_pairs=self.store.end - begin,
            relative=self._relative.running,
            estimate_coverage=self._estimate_coverage(),
            coverage=self._coverage.coverage(),
            dropped=self._dropped,
            waiting=self.buffer.waiting,
            consistency=consistency,
            why_not_consistency=why_not,
            integrity=window_integrity(
                consistency, self.settings.integrity, self.store.stamps(begin)
            ),
            loss=loss,
            ate_before_loss_m=None if loss is None else self._ate_before_m,
            about_yaw=self._yaw.remark,
        )

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
        found = self._aligning.found
        return None if found is None else self.frames.between_own_axes(found)

    @property
    def frozen_at(self) -> int | None:
        """Number of states of the frozen alignment; None while it is not frozen."""
        if not (self.settings.freeze and self._aligning.is_kept) or self._aligning.found is None:
            return None
        return self._aligning.found.states_used

    def set_gauge(self, gauge: Gauge) -> None:
        """Change the gauge; call it before the first groundtruth."""
        self.settings = self.settings.with_gauge(gauge)
        self.frames.gauge = gauge
        self._begin_to_align()

    def judge_moved_groundtruth(self, hand_eye: HandEye) -> None:
        """Judge covariances from now on by groundtruth moved from a marker to the body."""
        self.settings = self.settings.with_moved_groundtruth(hand_eye)

    def _begin_to_align(self) -> None:
        self._relative = RelativeTracker(self.settings.protocol)
        self._aligning = LiveAlignment(self.settings.protocol, freezes=self.settings.freeze)

    def change(self, settings: OnlineSettings) -> None:
        """Use other lengths and another window from now on; other settings are kept.

        A larger window fills with new pairs. A new length starts at the next pair.
        """
        self.settings = self.settings.with_lengths_and_window_of(settings)
        self._relative = self._relative.with_lengths(self.settings.protocol, self.store.end)

    def set_offset(self, offset_s: float) -> None:
        """Set the offset of the estimate's timestamps, seconds; call it before the first state."""
        self.settings = self.settings.with_offset(offset_s)

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
            dropped=self._dropped,
        )

    def _pairs_from(self, begin: int) -> Association:
        stamps = self.store.stamps(begin)
        return Association(
            rule=self.rule,
            groundtruth=trajectory(stamps, self.store.groundtruth(begin), self.frames.vertical),
            estimate=trajectory(stamps, self.store.estimate(begin)),
            estimate_coverage=0.0,
            coverage=Coverage(0.0, 0.0),
            dropped={},
            from_the_start=isinstance(self.buffer, SparsePairing)
            or bool(stamps[0] == self.buffer.estimate_counts.first),
        )

    def _ends(self, *, at_end: bool) -> tuple[RelativeEnd, ...]:
        """Return the sub-trajectories that end by the newest pair, if poses have orientations."""
        first = QUATERNION.start
        if not len(self.store):
            return ()
        if np.isnan(self.store.groundtruth()[-1, first] + self.store.estimate()[-1, first]):
            return ()
        found = self._aligning.found
        scale = 1.0 if found is None else found.similarity.scale
        return self._relative.update(self.store, scale, at_end=at_end)

    def _settle(self, rows: Floats) -> None:
        """Resolve association `auto` by the first usable groundtruth states, if there are any."""
        usable = np.flatnonzero(np.isfinite(rows[:, POSITION]).all(axis=1))
        if not len(usable):
            return
        self._is_settled = True
        if np.isnan(rows[usable[0], QUATERNION.start]):
            self._pair_by(SparsePairing.after(self.buffer))

    def _pair_by(self, buffer: Pairing) -> None:
        self.buffer = buffer
        self.tracking = LostTracking(of_fixes=isinstance(buffer, SparsePairing))
        of_kind = LiveCompleteness if isinstance(buffer, SparsePairing) else LiveCoverage
        self._coverage: LiveCompleteness | LiveCoverage = of_kind(buffer, self._record_waypoints)

    def _add_covariances(self, pairs: Pairs) -> None:
        """Test covariances of inertial estimators, in a frame with z up."""
        if pairs.estimate.shape[1] > WIDTH and self.settings.protocol.gauge is Gauge.YAW:
            covariances = pairs.estimate[:, COVARIANCE].reshape(-1, 6, 6)[:, 3:, 3:]
            self._yaw.add(pairs.stamps, covariances, np.array([0.0, 0.0, 1.0]))

    def _in_order(self, pairs: Pairs) -> Pairs:
        """Drop pairs older than the newest one; the recording keeps them."""
        if not len(self.store) or pairs.stamps[0] > self.store.stamps()[-1]:
            return pairs
        new = pairs.stamps > self.store.stamps()[-1]
        self._late += int(np.count_nonzero(~new))
        return pairs.picked(new)

    def _window_moments(self, begin: int) -> Moments:
        if self.settings.window.is_whole_run or not len(self.store):
            return self._aligning.whole
        pairs = self.store.groundtruth(begin), self.store.estimate(begin)
        return self._aligning.moments(*pairs, self._aligning.whole.anchor)

    def _errors_of(self, pairs: Pairs) -> tuple[PairErrors, ...]:
        """Return errors of pairs between the frames' own axes under the present alignment."""
        alignment = self.alignment
        if alignment is None:
            return ()
        rotation = not alignment.why_withheld(self.settings.protocol)
        return (
            PairErrors(pairs, alignment.similarity, self.frames.groundtruth_up, rotation=rotation),
        )

    @property
    def _dropped(self) -> dict[str, int]:
        """Number of states without an evaluated pair by reason."""
        return add_counts(self.buffer.dropped, {"out_of_order": self._late})

    def _estimate_coverage(self) -> float | None:
        """Return the share of estimated states in a pair; None for pairs at fixes and points."""
        if isinstance(self.buffer, SparsePairing):
            return None
        dropped = self.buffer.dropped.items()
        states = self._count + sum(count for reason, count in dropped if reason not in NO_STATE)
        return self._count / states if states else None
