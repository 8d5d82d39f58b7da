"""A recording as input of a watchdog, in slices of time as in a live run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.watchdog.engine import ARMING_S, Watchdog
from trajeval_ros.watchdog.signals import Readings, Signals, joined, source_of
from trajeval_ros.watchdog.unseen import unseen

_SLICE_S = 10.0


@dataclass(frozen=True, eq=False)
class WatchedRun:
    """An estimate and the sources that it is compared with.

    Attributes:
        estimate: The states that are watched, in order of arrival.
        twist: Angular velocities in the estimate's messages; None if they have none.
        imu: Readings of the robot's IMU.
        partners: Second estimates of the same robot, of any frame, body and scale, by source (see
            `pair_sources`).
        corrections: Transforms from the map to the estimate's frame.
    """

    estimate: Trajectory
    twist: InertialReadings | None = None
    imu: InertialReadings | None = None
    partners: Mapping[str, Trajectory] = field(default_factory=dict)
    corrections: Trajectory | None = None

    @property
    def others(self) -> list[Trajectory]:
        """Second estimates and corrections."""
        corrections = [] if self.corrections is None else [self.corrections]
        return [*self.partners.values(), *corrections]


@dataclass(frozen=True, eq=False)
class Watched:
    """Signals of a recording.

    Attributes:
        origin: Timestamp, ns, from which seconds are counted.
        signals: Values since arming, by name.
        armed_s: Time of arming, s.
        end_s: Time of the last state, s.
        notices: Findings about the sources, one sentence each.
    """

    origin: int
    signals: Signals
    armed_s: float
    end_s: float
    notices: tuple[str, ...]

    @property
    def hours(self) -> float:
        """Duration since arming, hours."""
        return (self.end_s - self.armed_s) / 3600.0


def watched(run: WatchedRun) -> Watched:
    """Watch a recording.

    Raises:
        InputError: The estimate has no orientations, or the robot hardly moves.

    Example:
        >>> from trajeval_ros import simulate
        >>> from trajeval_ros.watchdog.recording import WatchedRun, watched
        >>> seen = watched(WatchedRun(simulate(seed=1, duration_s=60.0).estimate))
        >>> sorted(seen.signals)[:2]
        ['freeze_hard_s', 'gap']
    """
    name = run.estimate.name or "the estimate"
    if not len(run.estimate):
        raise InputError(f"{name} has no usable pose")
    for each in (run.estimate, *run.others):
        if not each.stamped:
            raise InputError(
                f"{each.name or 'an estimate'} has no timestamps, which watch needs; give a "
                "recording with timestamps"
            )
        if each.quaternions is None:
            raise InputError(
                f"{each.name or 'an estimate'} has no orientations, which watch needs; give a "
                "topic with poses"
            )
    watchdog = Watchdog(int(run.estimate.stamps[0]), tuple(run.partners))
    signals = feed(watchdog, run)
    if watchdog.armed_s is None:
        raise InputError(
            f"{name} has only {watchdog.moved_s:.0f} s of motion, and arming needs {ARMING_S:g} "
            "s; give a run with more motion"
        )
    needs = {
        need
        for need, source in (
            ("twist", run.estimate.velocities),
            ("imu", run.imu),
            ("map", run.corrections),
            *run.partners.items(),
        )
        if source is not None
    }
    there = {source_of(name) for name in signals}
    notices = [*watchdog.notices, *unseen(needs, there, watchdog.notices)]
    if watchdog.out_of_order:
        notices.append(
            f"{counted(watchdog.out_of_order, 'state')} of {name} dropped: timestamps do not "
            "increase"
        )
    return Watched(watchdog.origin, signals, watchdog.armed_s, watchdog.last_s, tuple(notices))


def feed(watchdog: Watchdog, run: WatchedRun) -> dict[str, Readings]:
    """Feed a run to a watchdog in order of time, and return the signals."""
    return joined(list(_fed(watchdog, run)))


def _fed(watchdog: Watchdog, run: WatchedRun) -> Iterator[Signals]:
    """Feed all sources in slices of time, as in a live run, and yield the signals."""
    estimate, imu = run.estimate, run.imu
    velocities = _body_velocities(estimate)
    rates = None if run.twist is None else rates_at(estimate.stamps, run.twist)
    takers: list[Callable[[Stamps, Floats, Floats], Signals]] = [
        partial(watchdog.add_partner, source=each) for each in run.partners
    ]
    if run.corrections is not None:
        takers.append(watchdog.add_corrections)
    sources = [estimate.stamps, *(each.stamps for each in run.others)]
    if imu is not None:
        sources.append(imu.stamps)
    first = min(int(each.min()) for each in sources)
    slices = [_slices(each, first) for each in sources]
    empty = np.empty(0, dtype=np.int64)
    for own in itertools.zip_longest(*slices, fillvalue=empty):
        if imu is not None:
            rows = own[-1]
            assert imu.accelerations is not None
            yield watchdog.add_inertial(imu.stamps[rows], imu.rates[rows], imu.accelerations[rows])
        for take, other, rows in zip(takers, run.others, own[1:], strict=False):
            assert other.quaternions is not None
            yield take(other.stamps[rows], other.positions[rows], other.quaternions[rows])
        rows = own[0]
        assert estimate.quaternions is not None
        yield watchdog.add_states(
            estimate.stamps[rows],
            estimate.positions[rows],
            estimate.quaternions[rows],
            None if velocities is None else velocities[rows],
            None if rates is None else rates[rows],
        )


def _slices(stamps: Stamps, first: int) -> list[Stamps]:
    """Return the row indices by slice of time, in order of arrival.

    A timestamp that steps back belongs to the slice of the latest timestamp before it.
    """
    latest = np.maximum.accumulate(stamps) - first
    number = latest // round(_SLICE_S * NANOSECONDS)
    places = np.searchsorted(number, np.arange(int(number[-1]) + 2))
    rows = np.arange(len(stamps))
    return [rows[begin:end] for begin, end in itertools.pairwise(places.tolist())]


def _body_velocities(estimate: Trajectory) -> Floats | None:
    """Return the velocities (N, 3) in the body."""
    if estimate.velocities is None or estimate.quaternions is None:
        return None
    return lie.rotate(lie.conjugate(estimate.quaternions), estimate.velocities)


def rates_at(stamps: Stamps, twist: InertialReadings) -> Floats:
    """Return angular velocities (N, 3), rad/s, at states.

    Args:
        stamps: Timestamps of the states (N,), ns.
        twist: Angular velocities in the same messages; a state without one has NaN.
    """
    order = np.argsort(twist.stamps, kind="stable")
    place = np.minimum(np.searchsorted(twist.stamps[order], stamps), len(order) - 1)
    rows = order[place]
    same = twist.stamps[rows] == stamps
    rates: Floats = np.where(same[:, None], twist.rates[rows], np.nan)
    return rates
