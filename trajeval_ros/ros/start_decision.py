"""The start of the evaluation in a live run, after clock offset and marker pose are estimated."""

from __future__ import annotations

import math

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.marker_body import MarkerBody

_DECISION_S = 60.0


class StartDecision:
    """Decides on one clock offset and one body for all estimates.

    Both are estimated from the first estimate, because estimates with different offsets are not
    comparable. The clock offset of a path can't be estimated.
    """

    def __init__(self, body: MarkerBody, *, find_offset: bool) -> None:
        """Create it; messages are stored only if a marker pose or the offset is requested.

        With `find_offset`, the clock offset is estimated, and applied if it is significant.
        """
        self.body, self.finds_offset = body, find_offset
        # Whether messages are only stored, because the decision is still open.
        self.holds = find_offset or body.is_wanted
        self.about_clocks = ""  # a sentence about the clock offset, if it was requested
        self._is_oriented: bool | None = None  # of the groundtruth; None before its first state

    @property
    def waits_for(self) -> str:
        """What the start of the evaluation waits for; empty after the start."""
        if not self.holds:
            return ""
        clocks = "the clock offset" if self.finds_offset else ""
        marker = f"hand_eye {self.body.source}" if self.body.is_wanted else ""
        return " and ".join(filter(None, (clocks, marker)))

    def see_groundtruth(self, states: Trajectory) -> None:
        """Determine from groundtruth states, N > 0, whether they have orientations."""
        if self._is_oriented is None:
            self._is_oriented = states.quaternions is not None

    def look(self, first: LiveEstimate, held_s: float, *, at_end: bool = False) -> float | None:
        """Return the clock offset, seconds, at the moment of the decision; otherwise None.

        The decision is made when everything is known about the first estimate, after one minute of
        held messages, or `at_end`.
        """
        if not self.holds:
            return None
        is_spent = at_end or held_s >= _DECISION_S
        is_significant = first.clock.report.is_significant
        is_known = is_significant or first.revised is not None or not self.finds_offset
        if self.body.is_wanted:
            is_known &= self.body.look(first.clock.calibration, is_spent=is_spent)
            if self._is_oriented is None and not at_end and held_s < math.inf:
                return None
        if not (is_known or is_spent):
            return None
        self.holds = False
        if self.body.is_wanted:
            gauge = first.evaluator.settings.protocol.gauge
            self.body.settle(is_oriented=self._is_oriented is not False, has_scale=gauge.has_scale)
        return self._offset_s(first) if self.finds_offset else first.evaluator.settings.offset_s

    def _offset_s(self, first: LiveEstimate) -> float:
        known, name = first.clock.report, first.name
        if not known.is_significant or known.offset_s is None:
            self.about_clocks = f"no time offset applied ({name}: {known.reason})"
            return 0.0
        self.about_clocks = (
            f"time offset of {known.offset_s:.4f} s applied, estimated from the first "
            f"{known.span_s:.0f} s of {name} (+- {known.half_width_95_s:.2g} s, 95 %)"
        )
        return known.offset_s
