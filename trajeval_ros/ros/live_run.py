"""A live run: one groundtruth, its estimates, and the folder that they leave. No timers here."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, add_counts
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairingBuffer
from trajeval_ros.online.reports import Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.output_folder import Finisher
from trajeval_ros.ros.sides import Side

_QUIET_S = 0.1
_LAST_MESSAGES_S = 2.0
_SAME_CLOCK_S = 60.0
_DECISION_S = 60.0


class LiveRun:
    """Feeds every estimate with the same groundtruth, and keeps what is found on disk.

    Attributes:
        groundtruth: Where it comes from.
        estimates: One for each estimate topic.
        finisher: Writes result.json, in a process of its own.
        watch: Is given stamps and states of the groundtruth, to draw them.
        holds: Whether nothing is evaluated yet, since the clocks' offset is to be found first.
    """

    def __init__(
        self,
        groundtruth: Side,
        sides: Sequence[Side],
        settings: OnlineSettings,
        words: dict[str, Any],
        folder: Path,
        *,
        find_offset: bool = False,
    ) -> None:
        """Begin.

        Args:
            groundtruth: Where it comes from.
            sides: Where the estimates come from.
            settings: What to do.
            words: The same, as `settings.protocol_from` takes them.
            folder: For the files; it exists.
            find_offset: Estimate the clocks' offset from the first minute, and apply it if it is
                significant.

        Raises:
            InputError: The files can't be made.
        """
        self.groundtruth, self.finisher = groundtruth, Finisher(folder)
        self.words = words
        self._given_up = None if settings.up is None else settings.up[0]
        self.watch: Callable[[Stamps, Floats], object] | None = None
        self.estimates = [
            LiveEstimate(side, settings, folder, groundtruth.source, place, hold=find_offset)
            for place, side in enumerate(sides)
        ]
        self.holds, self._about_clocks = find_offset, ""
        for each in self.estimates:
            each.write_state(self._state(each))

    @property
    def groundtruth_up(self) -> UpAxis:
        """Which axis points up in the groundtruth's frame."""
        return self.groundtruth.stream.up(self._given_up)

    def take(self, now_ns: int | None) -> None:
        """Take what has arrived; `now_ns` is the simulated time."""
        for message_type, taken, arrived in self.groundtruth.take(now_ns):
            poses = self.groundtruth.stream.poses(message_type, taken.payloads, arrived)
            for each in self.estimates:
                each.evaluator.groundtruth_up = self.groundtruth_up
                each.add_groundtruth(poses.stamps, poses.states)
            if self.watch is not None:
                self.watch(poses.stamps, poses.states)
        for each in self.estimates:
            each.take(now_ns)
            each.clock.update()
        self._decide()

    def update(self) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate what has been taken, estimate by estimate."""
        for each in self.estimates:
            yield each, each.update()

    def change(self, settings: OnlineSettings, words: dict[str, Any]) -> None:
        """Go on with other lengths and another window."""
        self.words = {**words, "time_offset": self.words["time_offset"]}
        for each in self.estimates:
            each.evaluator.change(settings)

    def write_states(self) -> None:
        """Write what `trajeval finish` can't tell from pairs."""
        for each in self.estimates:
            each.write_state(self._state(each))

    def save(self) -> None:
        """Begin to write result.json; there are pairs, and nothing is being written.

        Raises:
            InputError: The disk takes no more.
        """
        self.write_states()
        for each in self.estimates:
            each.write_revised()
        self.finisher.save()

    def drain(self, now_ns: int | None) -> None:
        """Take and evaluate the last messages, those still on their way included."""
        until = time.monotonic() + _LAST_MESSAGES_S
        quiet_since = time.monotonic()
        while time.monotonic() < min(until, quiet_since + _QUIET_S):
            before = self._received
            self.take(now_ns)
            if self._received > before:
                quiet_since = time.monotonic()
            time.sleep(_QUIET_S / 10)
        self.conclude(now_ns)

    def conclude(self, now_ns: int | None) -> None:
        """Take and evaluate what has arrived, and what waits for groundtruth that won't come."""
        self.take(now_ns)
        for each in self.estimates:
            each.clock.update(at_end=True)
        self._decide(at_end=True)
        for each in self.estimates:
            each.update(at_end=True)
            each.digest()

    def close(self) -> list[str]:
        """Have all pairs on disk; returns why some are not."""
        self.write_states()
        troubles = [_trouble(each.write_revised) for each in self.estimates]
        troubles += [_trouble(each.writer.close) for each in self.estimates]
        return [each for each in troubles if each]

    def missing(self, estimate: LiveEstimate) -> str:
        """Return the source that nothing has come from yet; empty if both have spoken."""
        sides = (self.groundtruth, estimate.side)
        return next((each.source for each in sides if each.silent_s is None), "")

    def groundtruth_dropped(self, estimate: LiveEstimate) -> dict[str, int]:
        """Return the number of groundtruth states that an estimate can't use, by reason."""
        return add_counts(
            self.groundtruth.stream.status.dropped, estimate.evaluator.buffer.groundtruth_dropped
        )

    def why_no_pair(self) -> str:
        """Return what has come instead of what makes pairs."""
        dropped = [
            self.groundtruth_dropped(self.estimates[0]),
            *(
                add_counts(each.stream.status.dropped, each.evaluator.buffer.dropped)
                for each in self.estimates
            ),
        ]
        sides = [self.groundtruth, *(each.side for each in self.estimates)]
        counts = [
            f"{side.stream.status.poses} poses on {side.source}"
            + (f" ({reasons(of)})" if of else "")
            for side, of in zip(sides, dropped, strict=True)
        ]
        return "no pair of estimate and groundtruth was made, so there is no result: " + ", ".join(
            counts
        )

    @property
    def has_pairs(self) -> bool:
        """Whether there is anything to evaluate."""
        return any(each.evaluator.pairs for each in self.estimates)

    def _decide(self, *, at_end: bool = False) -> None:
        """Go on by one clock for all estimates, once that of the first is known, or a minute on.

        Estimates with clocks of their own couldn't be ranked. A path's clock is never known.
        """
        first = self.estimates[0]
        known = first.clock.report
        spent = max(each.held_s for each in self.estimates) >= _DECISION_S
        settled = known.is_significant or first.revised is not None
        if not self.holds or not (settled or spent or at_end):
            return
        self.holds = False
        offset_s = 0.0
        name = first.name
        if known.is_significant and known.offset_s is not None:
            offset_s = known.offset_s
            self._about_clocks = (
                f"a time offset of {offset_s:.4f} s is applied, estimated from the first "
                f"{known.span_s:.0f} s of {name} (+- {known.half_width_95_s:.2g} s, 95 %)"
            )
        else:
            self._about_clocks = f"no time offset is applied ({name}: {known.reason})"
        self.words = {**self.words, "time_offset": offset_s}
        for each in self.estimates:
            each.release(offset_s)

    @property
    def _received(self) -> int:
        streams = [self.groundtruth.stream, *(each.stream for each in self.estimates)]
        return sum(each.status.poses for each in streams)

    def _state(self, estimate: LiveEstimate) -> dict[str, Any]:
        truth, buffer = self.groundtruth.stream.status, estimate.evaluator.buffer
        return {
            "settings": self.words,
            "groundtruth": {
                "poses": truth.poses,
                "states": buffer.groundtruth_count,
                "duration_s": truth.duration_s,
                "path_length_m": buffer.groundtruth_path_m,
                "time_without_gaps_ns": buffer.groundtruth_time,
                "frame": truth.frame,
                "child_frame": truth.child_frame,
                "up": asdict(self.groundtruth_up),
                "dropped": self.groundtruth_dropped(estimate),
                "notes": list(truth.notes),
            },
            "live": {
                "messages_lost": estimate.side.lost,
                "groundtruth_messages_lost": self.groundtruth.lost,
                "losses_are_exact": estimate.side.loss_is_exact and self.groundtruth.loss_is_exact,
                "arrival_offset_s": estimate.stream.arrivals.offset_s,
                "groundtruth_arrival_offset_s": self.groundtruth.stream.arrivals.offset_s,
                "sync_risk_m": sync_risk_m(self.groundtruth, estimate.side, buffer),
                "latency_p95_s": estimate.latency.p95_s,
                "jumps": estimate.jumps.count,
                "clock": asdict(estimate.clock.report),
            },
            "warnings": self._warnings(estimate),
        }

    def _warnings(self, estimate: LiveEstimate) -> list[str]:
        warnings = [
            f"{side.lost} messages of {side.source} were lost on their way to the live evaluator"
            for side in (self.groundtruth, estimate.side)
            if side.lost
        ]
        if self._about_clocks:
            warnings.append(self._about_clocks)
        if forgotten := estimate.evaluator.buffer.why_forgotten:
            warnings.append(forgotten)
        if estimate.writer.lost:
            warnings.append(
                f"{estimate.writer.lost} pairs are missing, since the disk took no more: "
                f"{estimate.writer.why_lost}"
            )
        return warnings


def sync_risk_m(groundtruth: Side, estimate: Side, buffer: PairingBuffer) -> float | None:
    """Return what the clocks can have done to the position error, metres.

    That is the groundtruth's mean speed times the difference of the two offsets between stamp and
    arrival: as if all of it came from the clocks, nothing from the time that estimating takes.
    None if stamps aren't of the clock that arrivals are of, as in a replay without simulated time.
    """
    one, other = groundtruth.stream.arrivals.offset_s, estimate.stream.arrivals.offset_s
    if one is None or other is None or not buffer.groundtruth_time:
        return None
    if max(abs(one), abs(other)) > _SAME_CLOCK_S:
        return None
    speed = buffer.groundtruth_path_m / (buffer.groundtruth_time / NANOSECONDS)
    return speed * abs(one - other)


def _trouble(write: Callable[[], object]) -> str:
    """Return why something can't be written; empty if it could."""
    try:
        write()
    except TrajevalError as error:
        return str(error)
    return ""
