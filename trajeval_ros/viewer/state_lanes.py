"""Lanes of states over time: status, gaps, GNSS status and alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.arrays import Booleans, Indices, Stamps
from trajeval_ros.metrics.discontinuities.events import DIVERGED, FROZEN, Loss
from trajeval_ros.viewer import colours, entity_data, scene_entities
from trajeval_ros.viewer.live_path import LiveRecording
from trajeval_ros.viewer.sdk import sdk

OK, WARNING, ERROR, NO_DATA = "OK", "warning", "error", "no data"
TRACKED, GAP = "tracked", "gap"
_GOOD, _QUIET = (38, 115, 77), (84, 88, 98)
_COLOURS: dict[str, colours.Colour] = {
    OK: _GOOD,
    WARNING: (196, 128, 24),
    ERROR: (190, 52, 52),
    NO_DATA: _QUIET,
    TRACKED: _GOOD,
    GAP: (190, 52, 52),
    FROZEN: (190, 52, 52),
    DIVERGED: (190, 52, 52),
}
_OF_LEVEL = {Level.NOTE: OK, Level.WARNING: WARNING, Level.ERROR: ERROR}
# sensor_msgs/NavSatStatus: ground-based augmentation is used by differential and RTK solutions.
_OF_FIX = {-2: "unknown", -1: "no fix", 0: "fix", 1: "SBAS fix", 2: "GBAS or RTK fix"}


def declare_lane(recording: Any, entity: str) -> None:
    """Log the colours of a lane's states."""
    rerun, _ = sdk()
    known = {**_COLOURS, **{word: colours.of_fix(status) for status, word in _OF_FIX.items()}}
    style = rerun.StateConfiguration(
        values=list(known), colors=np.array(list(known.values()), dtype=np.uint8)
    )
    recording.log(entity, style, static=True)


def send_lane(recording: Any, entity: str, stamps: Stamps, states: Sequence[str]) -> None:
    """Log a whole lane: its state at timestamps (N,), N > 0; equal states are joined."""
    declare_lane(recording, entity)
    changes = [row for row, state in enumerate(states) if not row or state != states[row - 1]]
    for row in changes:
        entity_data.log(recording, entity, int(stamps[row]), _state(states[row]))


def send_gaps(recording: Any, entity: str, stamps: Stamps, are_gaps: Booleans) -> None:
    """Log where pairs at timestamps (N,) have gaps, by the steps (N - 1,) that are gaps."""
    rows = np.flatnonzero(are_gaps)
    times = np.stack([stamps[rows], stamps[rows + 1]], axis=1).ravel()
    states = [TRACKED, *len(rows) * [GAP, TRACKED]]
    send_lane(recording, entity, np.concatenate([stamps[:1], times]), states)


def send_fixes(recording: Any, stamps: Stamps, status: Indices) -> None:
    """Log the status of GNSS fixes (N,), N > 0."""
    words = [_OF_FIX.get(item, _OF_FIX[-2]) for item in status.tolist()]
    send_lane(recording, scene_entities.FIX_STATUS, stamps, words)


def _state(word: str) -> Any:
    rerun, _ = sdk()
    return rerun.StateChange(state=word)


class LiveLanes:
    """Draws lanes as their states change; memory is bounded by the number of lanes."""

    def __init__(self, recording: LiveRecording) -> None:
        self._recording = recording
        self._now: dict[str, tuple[int, str]] = {}  # time of the change and state, by entity

    def draw_again(self) -> None:
        """Draw the present states on a new recording."""
        for entity, (stamp, state) in self._now.items():
            self._draw(entity, stamp, state, is_new=True)

    def change(self, entity: str, stamp: int, state: str) -> None:
        """Draw a state if it differs from the present one."""
        before = self._now.get(entity)
        if before is not None and (before[1] == state or stamp < before[0]):
            return
        self._now[entity] = stamp, state
        self._draw(entity, stamp, state, is_new=before is None)

    def fixes(self, stamps: Stamps, status: Indices) -> None:
        """Draw the status of new GNSS fixes (N,)."""
        for stamp, item in zip(stamps.tolist(), status.tolist(), strict=True):
            self.change(scene_entities.FIX_STATUS, stamp, _OF_FIX.get(item, _OF_FIX[-2]))

    def tracking(self, entity: str, stamp: int, loss: Loss | None) -> None:
        """Draw a loss of tracking from its begin on, and its end, on a lane that has begun."""
        if entity not in self._now:
            return
        if loss is not None:
            self.change(entity, max(loss.t_ns, self._now[entity][0]), loss.kind)
        elif self._now[entity][1] in (FROZEN, DIVERGED):
            self.change(entity, stamp, TRACKED)

    def gap(self, entity: str, stamp: int, step_ns: int) -> None:
        """Draw a gap that ends at a timestamp."""
        self.change(entity, stamp - step_ns, GAP)
        self.change(entity, stamp, TRACKED)

    def status(self, name: str, stamp: int, remarks: Sequence[Remark]) -> None:
        """Draw the status of an estimate, and a lane per quantity that was beyond its limit."""
        worst = max(remarks, key=lambda remark: remark.level, default=Remark(Level.NOTE, "", ""))
        is_silent = worst.code == "silence" and worst.level > Level.NOTE
        state = NO_DATA if is_silent else _OF_LEVEL[worst.level]
        self.change(scene_entities.lane(scene_entities.STATUS, name), stamp, state)
        alarms: Mapping[str, Level] = {
            scene_entities.lane(scene_entities.ALARM, name, remark.subject): remark.level
            for remark in remarks
            if remark.code == "alarm"
        }
        known = scene_entities.lane(scene_entities.ALARM, name, "")
        for entity in [*alarms, *(item for item in self._now if item.startswith(known))]:
            self.change(entity, stamp, _OF_LEVEL[alarms.get(entity, Level.NOTE)])

    def _draw(self, entity: str, stamp: int, state: str, *, is_new: bool) -> None:
        if is_new:
            self._recording.send(declare_lane, entity)
        self._recording.log(stamp, entity, _state(state))
