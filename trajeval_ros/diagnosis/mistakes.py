"""All tests of a recording for mistakes, in their order.

Every test relies on the previous ones: numbers, groundtruth, clocks, restarts, conventions, and
then scale, axes and bodies. A finding that invalidates the next tests ends them. Drift is never
reported as a mistake: all tests use short motions, in which it is small.
"""

from __future__ import annotations

from trajeval_ros.diagnosis.both_sides import Recording
from trajeval_ros.diagnosis.clock_tests import SMALL_S, USABLE, clock_offset, clock_rate
from trajeval_ros.diagnosis.column_tests import rhythm, velocities
from trajeval_ros.diagnosis.convention_tests import conventions
from trajeval_ros.diagnosis.evidence import Examined, Seen
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.geometry_tests import (
    body,
    groundtruth_plane,
    lever_arm,
    scale,
    vertical,
)
from trajeval_ros.diagnosis.groundtruth_defects import groundtruth_defects
from trajeval_ros.diagnosis.hypotheses import fit_hypotheses
from trajeval_ros.diagnosis.input_tests import (
    duplicated_rows,
    rounded_stamps,
    same_positions,
    standing_still,
    swapped_names,
)
from trajeval_ros.diagnosis.motion_track import MotionTrack
from trajeval_ros.diagnosis.rates import ClockMatch, match_clocks
from trajeval_ros.diagnosis.restarts import restart
from trajeval_ros.diagnosis.short_motions import ShortMotions

_SHORTEST_S, _FEWEST = 8.0, 12
_MOVING_S, _TURNING_S = 2.0, 0.5
_LEAST_GAP_S, _MOST_GAP_S = 0.3, 1.1
# These findings invalidate all other tests.
_FINAL = {"identical", "stands_still", "stamps_rounded"}
_NO_PEAK, _LONG_S = 0.45, 20.0


def diagnose(recording: Recording) -> Diagnosis:
    """Search for mistakes in a recording.

    Args:
        recording: Both sides, with at least one state per side.
    """
    examined = [
        standing_still(recording),
        rounded_stamps(recording),
        same_positions(recording),
        duplicated_rows(recording),
        swapped_names(recording),
    ]
    if not _accepted(examined) & _FINAL:
        examined += _motions(recording)
    return Diagnosis.of(examined)


def _motions(recording: Recording) -> list[Examined]:
    truth, estimate = recording.in_order
    if min(truth.span_s, estimate.span_s) < _SHORTEST_S or len(estimate) < _FEWEST:
        return [Examined("motions", why_not=f"a side is shorter than {_SHORTEST_S:g} s")]
    examined, match = [], None
    if recording.by_time:
        examined += [
            groundtruth_defects(truth, estimate, recording.max_gap_s),
            rhythm(truth, estimate),
        ]
        defect = bool(_accepted(examined) - {"keyframes"})
        match = match_clocks(truth, estimate)
        examined += [clock_offset(match, recording.time_offset_s)]
        offset_s = _offset_of(match, examined[-1])
        if defect:
            drift = Examined("clock rates", why_not="the groundtruth has defects")
        else:
            drift = clock_rate(truth, estimate, match, offset_s, recording.time_offset_s)
        examined.append(drift)
        if drift.seen:
            estimate = estimate.shifted(drift.scores["offset_s"], 1e-6 * drift.scores["ppm"])
        else:
            estimate = estimate.shifted(offset_s)
    examined.append(velocities(truth, estimate))
    return [*examined, *_geometry(recording, truth, estimate, match)]


def _offset_of(match: ClockMatch | None, clocks: Examined) -> float:
    """Return the offset between the clocks that other tests apply, seconds."""
    if match is None:
        return 0.0
    small = match.is_alone and abs(match.offset_s) < SMALL_S and match.peak > USABLE
    return match.offset_s if clocks.seen or small else 0.0


def _geometry(
    recording: Recording, truth: MotionTrack, estimate: MotionTrack, match: ClockMatch | None
) -> list[Examined]:
    gap_s = max(recording.max_gap_s, 4.0 * truth.usual_step_s, _LEAST_GAP_S)
    step_s = estimate.usual_step_s
    if recording.by_time:
        gap_s = min(gap_s, _MOST_GAP_S)
    moving, turning = (
        ShortMotions.between(truth, estimate, apart_s, gap_s)
        for apart_s in (max(_MOVING_S, 2.0 * step_s), max(_TURNING_S, step_s))
    )
    if not (moving.enough and turning.enough):
        if match is not None and match.overlap_s > _LONG_S and match.peak < _NO_PEAK:
            other = Seen("other_run", 1.0, {"peak": match.peak})
            return [Examined("conventions", {"peak": match.peak}, (other,))]
        return [Examined("conventions", why_not="too few short motions have groundtruth")]
    examined = [restart(truth, estimate)]
    if examined[-1].seen:
        return examined
    moving, turning = moving.without_jumps(estimate), turning.without_jumps(estimate)
    hypotheses = fit_hypotheses(moving, turning)
    examined.append(conventions(hypotheses, moving, turning, match))
    if examined[-1].seen or "alike" in examined[-1].why_not:
        return examined
    as_read = hypotheses[0]
    examined.append(scale(as_read, moving, recording.gauge))
    if recording.groundtruth.up.is_given:
        examined.append(Examined("plane of the groundtruth", why_not="its up axis was given"))
    else:
        examined.append(groundtruth_plane(moving, turning, recording.gauge))
    if not examined[-1].seen:
        examined.append(vertical(as_read, moving, recording.gauge))
    return [*examined, body(as_read, moving), lever_arm(as_read, moving)]


def _accepted(examined: list[Examined]) -> set[str]:
    return {seen.cause for each in examined for seen in each.seen}
