"""As-available accuracy: the error of the newest pose that a receiver has.

At every instant t of a fixed rate, the newest pose received by t is compared with groundtruth at
t (M. Li, Y.-X. Wang, D. Ramanan, Towards Streaming Perception, ECCV 2020). The age of the pose is
split into latency, dropout and sampling, and the error along the same instants.
docs/as_available.md has the equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.geometry import lie, se3, so3
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association_rule import AssociationRule

HOLD, CONSTANT, TWIST = MOTIONS = "hold", "constant", "twist"
PARTS = ("estimator", "latency", "dropout", "sampling")
RATE_HZ, HORIZON_S = 100, 0.5
STEP_NS = NANOSECONDS // RATE_HZ
RECENT = 20  # intervals whose median is the usual one
_FIRST_NS = NANOSECONDS // 10  # usual interval of the first message
_NO_INTERVAL = 1 << 62
_USUAL = 2  # usual intervals that count as sampling; the time beyond is a dropout


@dataclass(frozen=True, eq=False)
class Messages:
    """The N messages that are ever the newest one, in the order of their receive time."""

    stamps: Stamps  # (N,) int64, nanoseconds, by the groundtruth's clock; ascending
    times: Stamps  # (N,) int64, nanoseconds, of receive time; ascending
    positions: Floats  # (N, 3), metres, in the estimate's frame
    quaternions: Floats  # (N, 4), xyzw, body to frame; the identity without orientations
    oriented: bool  # whether there are orientations
    twists: Floats | None = None  # (N, 6), m/s and rad/s in the body; None for `hold`
    corrected: Stamps | None = None  # (N,) receive_times of the newest corrections, or None
    late: int = 0  # number of other messages: those received after a newer one

    @classmethod
    def of(cls, estimate: Trajectory, times: Stamps, motion: str, offset_ns: int = 0) -> Messages:
        """Return the messages of an estimate that were received at times (N,), nanoseconds.

        `offset_ns` is added to the timestamps, not to the receive times. Of equal timestamps the
        first received is used, unless a correction arrived in between.
        """
        receive_times = estimate.reading.receive_times
        corrected = None if receive_times is None else receive_times.corrected
        order = np.argsort(times, kind="stable")
        stamps = estimate.stamps[order]
        newest = np.maximum.accumulate(stamps)
        steps = np.diff(newest, prepend=newest[:1] - 1)
        rows = order[steps > 0 if corrected is None else stamps == newest]
        made = cls(
            estimate.stamps[rows] + offset_ns,
            times[rows],
            estimate.positions[rows],
            estimate.known_quaternions[rows],
            estimate.quaternions is not None,
            corrected=None if corrected is None else corrected[rows],
            late=len(order) - len(rows),
        )
        if motion == HOLD:
            return made
        if motion == CONSTANT:
            return replace(made, twists=made._constant_twists())
        assert estimate.velocities is not None
        assert receive_times is not None
        assert receive_times.body_rates is not None
        body = lie.rotate(lie.conjugate(made.quaternions), estimate.velocities[rows])
        return replace(made, twists=np.hstack([body, receive_times.body_rates[rows]]))

    def _constant_twists(self) -> Floats:
        """Return the twists between successive poses, xi = Log(T_j^-1 T_k) / (s_k - s_j).

        The first pose has none. A correction of a pose keeps the pose's twist.
        """
        twists = np.zeros((len(self.stamps), 6))
        inverse = lie.conjugate(self.quaternions[:-1])
        moved = lie.rotate(inverse, np.diff(self.positions, axis=0))
        rotated = lie.rotation_vector(lie.multiply(inverse, self.quaternions[1:]))
        moved = se3.times(so3.inverse_left_jacobian(rotated), moved)
        steps_s = np.diff(self.stamps) / NANOSECONDS
        fresh = np.append(False, steps_s > 0.0)
        twists[fresh] = np.hstack([moved, rotated])[fresh[1:]] / steps_s[fresh[1:], None]
        newest = np.where(fresh, np.arange(len(twists)), 0)
        carried: Floats = twists[np.maximum.accumulate(newest)]
        return carried

    @property
    def usual_ns(self) -> Stamps:
        """The median of the last 20 intervals up to every message, (N,), nanoseconds."""
        distinct, place = np.unique(self.stamps, return_inverse=True)
        none = np.full(RECENT, _NO_INTERVAL)  # sorted behind all intervals
        intervals = np.concatenate([none, np.diff(distinct)])
        windows = np.sort(np.lib.stride_tricks.sliding_window_view(intervals, RECENT), axis=1)
        row = np.arange(len(distinct))
        count = np.minimum(row, RECENT)
        usual: Stamps = (windows[row, (count - 1) // 2] + windows[row, count // 2]) // 2
        usual[:1] = _FIRST_NS
        return usual[place]


@dataclass(frozen=True, eq=False)
class AvailableSamples:
    """The as-available errors at N instants."""

    messages: Messages  # all that were ever in use, aligned
    stamps: Stamps  # (N,) int64, nanoseconds, the instants
    rows: Indices  # (N,) message in use
    ages: Stamps  # (3, N) int64, nanoseconds: parts of the age: latency, dropout, sampling
    # (4, N, 3), metres, in the groundtruth's frame: parts of the error by `PARTS`.
    position: Floats
    # (4, N, 3), rad, the same for the rotation vector; None without orientations.
    rotation: Floats | None

    @property
    def position_m(self) -> Floats:
        """Lengths of the position errors, (N,), metres."""
        return np.asarray(np.linalg.norm(self.position.sum(axis=0), axis=1))

    @property
    def moved_m(self) -> Floats:
        """Lengths of the age errors, those without their estimator part, (N,), metres."""
        return np.asarray(np.linalg.norm(self.position[1:].sum(axis=0), axis=1))

    @property
    def age(self) -> Stamps:
        """Age of the pose in use, (N,), nanoseconds."""
        return np.asarray(self.ages.sum(axis=0))


def instants(begin: int, end: int) -> Stamps:
    """Return the instants of the fixed rate from `begin` to `end`, both included, nanoseconds."""
    return np.arange(-(-begin // STEP_NS), end // STEP_NS + 1) * STEP_NS


def in_use(messages: Messages, stamps: Stamps) -> Indices:
    """Return the newest message received by every instant (N,); -1 before the first one."""
    return messages.times.searchsorted(stamps, side="right") - 1


def sampled(
    groundtruth: Trajectory, messages: Messages, stamps: Stamps, association: AssociationRule
) -> AvailableSamples:
    """Return the as-available errors at instants (N,) after the first receive time.

    Instants without groundtruth at one of the four ages are left out. `messages`: aligned to the
    groundtruth, whose states are in order of time.
    """
    rows = in_use(messages, stamps)
    at_once = np.maximum(messages.stamps.searchsorted(stamps, side="right") - 1, rows)
    age, sooner = stamps - messages.stamps[rows], stamps - messages.stamps[at_once]
    usual = np.minimum(sooner, _USUAL * messages.usual_ns[at_once])
    # Ages up to which the four parts are counted: 0, latency, and latency with dropout.
    reached = np.stack([np.zeros_like(age), age - sooner, age - usual, age])
    states, bracket = association.interpolated(
        groundtruth, (messages.stamps[rows] + reached).ravel()
    )
    usable = bracket.usable.reshape(4, -1)
    kept = usable.all(axis=0)
    places = np.cumsum(usable.ravel()).reshape(4, -1)[:, kept] - 1
    rows, reached = rows[kept], reached[:, kept]
    positions, quaternions = _predicted(messages, rows, reached)
    position = states.positions[places] - positions
    rotation = None
    if states.quaternions is not None and messages.oriented:
        rotated = lie.multiply(states.quaternions[places], lie.conjugate(quaternions))
        rotation = np.diff(lie.rotation_vector(rotated), axis=0, prepend=0.0)
    position = np.diff(position, axis=0, prepend=0.0)
    ages = np.diff(reached, axis=0)
    return AvailableSamples(messages, stamps[kept], rows, ages, position, rotation)


def _predicted(messages: Messages, rows: Indices, reached: Stamps) -> tuple[Floats, Floats]:
    """Return positions (4, N, 3) and quaternions (4, N, 4), predicted at most by the horizon."""
    positions, quaternions = messages.positions[rows], messages.quaternions[rows]
    if messages.twists is None:
        shape = (len(reached), len(rows))
        return np.broadcast_to(positions, (*shape, 3)), np.broadcast_to(quaternions, (*shape, 4))
    seconds = np.minimum(reached / NANOSECONDS, HORIZON_S)[..., None]
    twists = messages.twists[rows] * seconds
    moved = se3.times(so3.left_jacobian(twists[..., 3:]), twists[..., :3])
    rotated = lie.from_rotation_vector(twists[..., 3:])
    quaternions = np.broadcast_to(quaternions, rotated.shape)
    return positions + lie.rotate(quaternions, moved), lie.multiply(quaternions, rotated)
