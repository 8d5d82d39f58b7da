"""The live evaluator of one estimate, at a constant cost per message."""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.consistency.yaw_information import YawInformation
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.valid_poses import LARGEST, NO_STATE
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association, Tracking
from trajeval_ros.metrics.association_rule import AUTO
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.discontinuities.events import FROZEN
from trajeval_ros.metrics.discontinuities.lost_tracking import TrackingLosses
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.premises import Doubts
from trajeval_ros.metrics.relative_errors import RelativeErrors
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.metrics.withholding import doubts_of
from trajeval_ros.online.live_alignment import LiveAlignment
from trajeval_ros.online.live_coverage import LiveCompleteness, LiveCoverage
from trajeval_ros.online.live_frames import LiveFrames
from trajeval_ros.online.live_relative_errors import RelativeEnd, RelativeTracker
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import PairedStates, Pairing
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.online.window import PairStore, judge_window, window_integrity, window_statistics

# Coverage, losses and ends of sub-trajectories are measured for the pairs of this time together:
# a measurement has a high fixed cost, and the results are as old.
_MEASURED_EVERY_NS = 400_000_000


class OnlineEvaluator:
    """Evaluates states of both streams as they arrive; results are available at any time.

    It associates, aligns and measures as `evaluate` does: counts are equal, statistics agree to
    1e-9. Late states are paired, too. Coverage and relative errors so far can differ, if states
    are late: pairs before the measured ones are left out of them. Association `auto` is resolved
    by the first groundtruth states: without orientations they are fixes or points, and the
    estimate is interpolated at their timestamps.

    Attributes:
        buffer: The pairing of the states.
        rule: Rule of the association, with `auto` as resolved so far.
        frames: Up axes of both frames, and conversions.
        store: The pairs of the window, and those that relative errors still need.
        losses: Losses of tracking: frozen and diverging estimates.
        up_axis_doubt: Why the groundtruth's up axis is doubtful; set by the caller, who has the
            path of the whole run. Empty if it is not.

    Example:
        >>> from trajeval_ros import OnlineEvaluator, simulate
        >>> flight, live = simulate(seed=1, duration_s=30.0), OnlineEvaluator()
        >>> live.add_groundtruth(flight.groundtruth)
        >>> live.add_estimate(flight.estimate)
        >>> live.update(at_end=True).pairs == live.snapshot().pairs > 500
        True
    """

    def __init__(self, settings: OnlineSettings | None = None) -> None:
        """Create an evaluator without states; without settings, with the defaults."""
        self.settings = settings or OnlineSettings()
        rule = self.settings.protocol.association
        self.frames = LiveFrames(self.settings)
        self._pair_by(Pairing(rule, self.settings.limits))
        self._is_settled = rule.method != AUTO
        self.store = PairStore()
        self._begin_to_align()
        self._count = 0
        self._measured_until = NEVER  # newest measured pair
        self._measured_at = NEVER  # newest state at the last measurement
        self._has_news = False  # whether states or pairs were added since then
        self._ended: tuple[RelativeEnd, ...] = ()  # since the last update
        self._yaw = YawInformation()
        self._ate_before_m: float | None = None  # until nothing suggested a loss of tracking
        self.up_axis_doubt = ""

    def add_groundtruth(self, block: Trajectory) -> None:
        """Take new groundtruth states, in any order.

        Raises:
            InputError: A number is not finite; `Trajectory.from_columns` drops such states.
        """
        _require_finite("groundtruth", block)
        block = self.frames.of_groundtruth(block)
        if not self._is_settled:
            self._settle(block)
        self.buffer.add_groundtruth(block)
        self._has_news = True

    def add_estimate(self, block: Trajectory) -> None:
        """Take new estimated states, in any order; see `add_groundtruth`.

        Raises:
            InputError: A number is not finite; `Trajectory.from_columns` drops such states. Or
                the protocol has a lever arm, and the states have no orientations.
        """
        _require_finite("estimate", block)
        block = self.frames.of_estimate(block)
        if offset_ns := self.settings.offset_ns:
            block = dataclasses.replace(block, stamps=block.stamps + offset_ns)
        self.buffer.add_estimate(block)
        self._has_news = True

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate the states since the last call.

        Args:
            at_end: No more groundtruth will come.
        """
        return self.evaluate(self.made(at_end=at_end), at_end=at_end)

    def made(self, *, at_end: bool = False) -> PairedStates | None:
        """Return the pairs that are possible now, of the same point; None without any."""
        pairs = self.buffer.made(at_end=at_end)
        return None if pairs is None else self.frames.of_same_point(pairs)

    def evaluate(self, pairs: PairedStates | None, *, at_end: bool = False) -> Update:
        """Evaluate new pairs of `made`; see `update`."""
        update = Update()
        if pairs is not None and len(pairs):
            self._count += len(pairs)
            self._has_news = True
            evaluated = self.frames.upright(pairs)
            self.store.add(evaluated)
            self._aligning.add(evaluated)
            self._add_covariances(evaluated.estimate)
            doubts = self._doubts_about(self._associated(evaluated))
            update = Update(len(pairs), int(pairs.stamps[-1]), self._errors_of(pairs, doubts))
        if at_end or self.buffer.newest - self._measured_at >= _MEASURED_EVERY_NS:
            self._measure(at_end=at_end)
        ended, self._ended = self._ended, ()
        return dataclasses.replace(update, ends=ended) if ended else update

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, at a cost proportional to the window's length.

        The position ATE of the window is that under the alignment of the run.
        """
        self._measure()
        begin = self.store.window_begin(self.settings.window)
        protocol, request = self.settings.protocol, self.settings.covariances
        alignment = self._aligning.alignment
        pairs, doubts, relative = None, Doubts(), self._relative.running
        if len(self.store):
            pairs = self._associated(self.store.pairs(slice(begin - self.store.begin, None)))
            doubts = self._doubts_about(pairs)
        ate: dict[str, Statistics | None] = {}
        if pairs is not None and alignment is not None:
            ate = window_statistics(pairs, alignment, doubts)
        if doubts.about(RelativeErrors, "position_m"):
            relative = {}
        loss = self.losses.present
        consistency, why_not = judge_window(pairs, protocol, request.once_turned)
        return Snapshot(
            pairs=self._count,
            stamp=self.store.newest if len(self.store) else None,
            warming_up=self._aligning.why_not,
            alignment=self.alignment,
            position_rmse_m=self._aligning.rmse(self._aligning.whole),
            window_position_rmse_m=self._aligning.rmse(self._window_moments(begin)),
            ate=ate,
            window_pairs=self.store.end - begin,
            relative=relative,
            estimate_coverage=self._estimate_coverage(),
            coverage=self._coverage.coverage(),
            dropped=self.buffer.dropped,
            waiting=self.buffer.waiting,
            consistency=consistency,
            why_not_consistency=why_not,
            integrity=window_integrity(
                consistency, self.settings.integrity, self.store.stamps(begin)
            ),
            loss=loss,
            ate_before_loss_m=None if loss is None else self._ate_before_m,
            about_yaw=self._yaw.remark,
            doubts=doubts,
        )

    @property
    def pairs(self) -> int:
        """Number of pairs so far."""
        return self._count

    @property
    def alignment(self) -> Alignment | None:
        """The present alignment, between the frames' own axes; None before the first one."""
        alignment = self._aligning.alignment
        return None if alignment is None else self.frames.between_own_axes(alignment)

    @property
    def frozen_at(self) -> int | None:
        """Number of states of the frozen alignment; None while it is not frozen."""
        if (
            not (self.settings.freeze and self._aligning.is_kept)
            or self._aligning.alignment is None
        ):
            return None
        return self._aligning.alignment.states_used

    def set_gauge(self, gauge: Gauge) -> None:
        """Change the gauge; call it before the first groundtruth."""
        self.settings = self.settings.with_gauge(gauge)
        self.frames.gauge = gauge
        self._begin_to_align()

    def _begin_to_align(self) -> None:
        self._relative = RelativeTracker(self.settings.protocol)
        self._aligning = LiveAlignment(self.settings.protocol, freezes=self.settings.freeze)

    def change(self, settings: OnlineSettings) -> None:
        """Use other lengths and another window from now on; other settings are kept.

        A larger window fills with new pairs. A new length starts at the next pair.
        """
        protocol = dataclasses.replace(self.settings.protocol, lengths=settings.protocol.lengths)
        self.settings = dataclasses.replace(
            self.settings, protocol=protocol, window=settings.window
        )
        self._relative = self._relative.with_lengths(self.settings.protocol, self.store.newest)

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
        self._measure()
        pairs = self.store.pairs(np.arange(len(self.store)))  # copies
        coverage = self._coverage.coverage() or Coverage(0.0, 0.0)
        frozen = tuple(loss for loss in self.losses.events if loss.kind == FROZEN)
        return dataclasses.replace(
            self._associated(pairs),
            estimate_coverage=self._estimate_coverage(),
            compute_tracking=lambda: Tracking(coverage, frozen),
            dropped=self.buffer.dropped,
        )

    def _associated(self, pairs: PairedStates) -> Association:
        """Return pairs as an association, without its counts."""
        return Association(
            rule=self.rule,
            groundtruth=pairs.groundtruth,
            estimate=pairs.estimate,
            estimate_coverage=0.0,
            compute_tracking=lambda: Tracking(Coverage(0.0, 0.0)),
            dropped={},
            from_the_start=self.buffer.at_groundtruth
            or bool(pairs.stamps[0] == self.buffer.estimate_counts.first),
        )

    def _measure(self, *, at_end: bool = False) -> None:
        """Measure coverage, losses and ended sub-trajectories; forget what nothing needs."""
        if not (self._has_news or at_end):
            return
        self._has_news = False
        begin = int(self.store.stamps().searchsorted(self._measured_until, side="right"))
        self._measured_until = self.store.newest
        self._measured_at = self.buffer.newest
        groundtruth, estimate = self.store.poses(slice(begin, None))
        self._coverage.measure(groundtruth, estimate)
        self.buffer.forget()
        if not len(self.store):
            return
        if len(groundtruth.stamps):
            self.losses.add(groundtruth.stamps, groundtruth.poses, estimate.poses)
            if self.losses.is_clear:
                self._ate_before_m = self._aligning.rmse(self._aligning.whole)
        self._ended += self._ends(at_end=at_end)
        window_begin = self.store.window_begin(self.settings.window)
        self.store.drop_before(min(window_begin, self._relative.oldest_needed(self.store)))

    def _ends(self, *, at_end: bool) -> tuple[RelativeEnd, ...]:
        """Return the sub-trajectories that end by the newest pair, unless they are withheld."""
        newest = self._associated(self.store.pairs(slice(-1, None)))
        if not newest.have_rotations:
            return ()
        alignment = self._aligning.alignment
        scale = 1.0 if alignment is None else alignment.similarity.scale
        ends = self._relative.update(self.store, scale, at_end=at_end)
        is_withheld = self._doubts_about(newest).about(RelativeErrors, "position_m")
        return () if is_withheld else ends

    def _settle(self, block: Trajectory) -> None:
        """Resolve association `auto` by the first usable groundtruth states, if there are any."""
        if not len(block):
            return
        self._is_settled = True
        if block.quaternions is None:
            self.buffer.pair_at_groundtruth()
            self._pair_by(self.buffer)

    def _pair_by(self, buffer: Pairing) -> None:
        self.buffer = buffer
        self.rule = buffer.rule
        self.losses = TrackingLosses(buffer.rule)
        self._coverage: LiveCompleteness | LiveCoverage = (
            LiveCompleteness(buffer)
            if buffer.at_groundtruth
            else LiveCoverage(buffer, self.losses)
        )

    def _add_covariances(self, estimate: Trajectory) -> None:
        """Test covariances of inertial estimators, in a frame with z up."""
        if estimate.covariances is not None and self.settings.protocol.gauge is Gauge.YAW:
            covariances = estimate.covariances[:, 3:, 3:]
            self._yaw.add(estimate.stamps, covariances, np.array([0.0, 0.0, 1.0]))

    def _window_moments(self, begin: int) -> Moments:
        if self.settings.window.is_whole_run or not len(self.store):
            return self._aligning.whole
        pairs = self.store.pairs(slice(begin - self.store.begin, None))
        return self._aligning.moments(pairs, self._aligning.whole.anchor)

    def _doubts_about(self, pairs: Association) -> Doubts:
        """Return which premises do not hold for pairs under the present alignment."""
        alignment = self._aligning.alignment
        if alignment is None:
            return Doubts()
        return doubts_of(pairs, alignment, self.settings.protocol, self.up_axis_doubt)

    def _errors_of(self, pairs: PairedStates, doubts: Doubts) -> tuple[PairErrors, ...]:
        """Return errors of pairs between the frames' own axes under the present alignment."""
        alignment = self.alignment
        if alignment is None:
            return ()
        return (PairErrors(pairs, alignment.similarity, doubts),)

    def _estimate_coverage(self) -> float | None:
        """Return the share of estimated states in a pair; None for pairs at fixes and points."""
        if self.buffer.at_groundtruth:
            return None
        dropped = self.buffer.dropped.items()
        states = self._count + sum(count for reason, count in dropped if reason not in NO_STATE)
        return self._count / states if states else None


def _require_finite(side: str, block: Trajectory) -> None:
    for name in ("positions", "velocities"):
        column = getattr(block, name)
        if column is not None and not (np.abs(column) <= LARGEST).all():
            raise InputError(
                f"the {side} has {name} that are not finite; make its blocks by "
                "Trajectory.from_columns, which leaves them out"
            )
