"""All causes of wrong results: name, message, advice and the option that corrects the mistake.

A test returns a cause by name with its numbers (`Detection`). The texts are here, the most severe
cause first. docs/diagnosis.md has the table that follows from this one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from trajeval_ros.metrics.discontinuities.events import (
    BOTH,
    CLOCK_STEP,
    ESTIMATE,
    GROUNDTRUTH,
    UNDECIDED,
)

FLAG = "true"  # value of an option without a value


@dataclass(frozen=True)
class Cause:
    """A mistake in the input, with its texts: format strings for the numbers of a test."""

    name: str  # a stable identifier, for `--correct` and for programs
    sentence: str  # the mistake and its evidence
    advice: str  # instruction for the user
    # What corrects it, by option of `evaluate` or by attribute of `Corrections`; empty if neither
    # does.
    correction: Mapping[str, str] = field(default_factory=dict)
    # Whether the poses have another convention than the reader assumed.
    of_conventions: bool = False
    # The ATE that its correction reduces: `position`, `rotation`, or "" for either.
    of_error: str = "position"
    rank: int = 0  # severity; causes that invalidate other tests have the largest values


_AGREE = "corrected, short motions agree to {agreement:.0f} % instead of {as_read:.0f} %"
_AT, _DURING = "at {end_s:.2f} s{gap}{number}", "at {begin_s:.2f} s{lasting}{number}"
_JUMPS = f"the {{side}} jumped by {{size}} {_AT}, which the {{other}} did not"
_FLIPS = f"the {{side}} rotated by {{deg:.0f}} deg {_DURING}, which the {{other}} did not"
_LEAVES = f"the {{side}} has an outlier of {{size}} {_DURING}"
_HELD = (
    "the rotation of the {side} is frozen from {begin_s:.1f} s{lasting}{number}, while the "
    "{other} rotates by {deg:.0f} deg"
)
_BEFORE, _UNTIL = "evaluate the part before it", {"end": "{begin_s:.3f}"}
_SPLIT, _DROP = "{parts}", {"drop_groundtruth_outliers": FLAG}

# fmt: off
_GROUNDTRUTH_EVENTS = (
    Cause("groundtruth_outlier", _LEAVES, "drop such poses", _DROP, of_error=""),
    Cause("groundtruth_flip", _FLIPS, "drop such poses", _DROP, of_error=""),
    Cause("groundtruth_flip_stays", _FLIPS, _BEFORE, _UNTIL),
    Cause("groundtruth_step", _JUMPS, _SPLIT),
    Cause("groundtruth_frozen_rotation", _HELD, _BEFORE, _UNTIL, of_error="rotation"),
)
_ESTIMATE_EVENTS = (  # errors of the estimate, which are no mistakes
    Cause("restart", "the estimate restarted at its origin at {end_s:.2f} s{gap}{number}: "
          "{size} that the groundtruth did not move", _SPLIT),
    Cause("step", _JUMPS, _SPLIT),
    Cause("outlier", _LEAVES, "check the estimator there"),
    Cause("flip", _FLIPS, "check the estimator there"),
    Cause("flip_stays", _FLIPS, _BEFORE, _UNTIL),
    Cause("frozen_position", "the position of the {side} is frozen from {begin_s:.1f} "
          "s{lasting}{number}, while the {other} moves {m:.2f} m", _BEFORE, _UNTIL),
    Cause("frozen_rotation", _HELD, _BEFORE, _UNTIL, of_error="rotation"),
)
# The most severe ones first. Those of a group are equally severe.
_BY_SEVERITY: tuple[Cause | tuple[Cause, ...], ...] = (
    Cause("identical", "estimate and groundtruth are identical: {percent:.0f} % of the positions "
          "{where} are equal", "give the file or topic of the estimator: --estimate SOURCE"),
    Cause("same_estimate", "the estimate is identical to {other}: all poses are equal",
          "give another file or topic: --estimate SOURCE"),
    Cause("stands_still", "the {side} does not move, while the {other} moves {path_m:.3g} m",
          "check the positions and the topic of the {side}: trajeval info SOURCE"),
    (
        Cause("diverged", "the estimate diverges from {at_s:.1f} s on{until}: it moves "
              "{moved_m:.3g} m while the groundtruth moves {true_m:.3g} m", _BEFORE,
              {"end": "{at_s:.3f}"}),
        Cause("diverged_at_start", "the estimate diverges from the start{until}: it moves "
              "{moved_m:.3g} m while the groundtruth moves {true_m:.3g} m",
              "check the initialisation of the estimator"),
    ),
    (
        Cause("frozen", "the estimate repeats its pose for {lost_s:.1f} s from {at_s:.1f} s "
              "on{number}, while the groundtruth moves {true_m:.2f} m and {true_deg:.0f} deg",
              _BEFORE, {"end": "{at_s:.3f}"}),
        Cause("frozen_at_start", "the estimate repeats its first pose for {lost_s:.1f} s{number}, "
              "while the groundtruth moves {true_m:.2f} m and {true_deg:.0f} deg",
              "evaluate the part after it", {"start": "{after_s:.3f}"}),
    ),
    Cause("stamps_rounded", "{owner} timestamps are rounded to {step_s:g} s: "
          "{poses_per_stamp:.0f} different poses per timestamp",
          "write timestamps with all digits"),
    Cause("swapped", "groundtruth and estimate are probably swapped: {groundtruth} is given as "
          "groundtruth, {estimate} as the estimate", "exchange -g and -e"),
    Cause("duplicated", "{percent:.0f} % of {owner} poses occur twice, {rows_apart:.0f} rows "
          "apart: a part was recorded twice", "remove the second copy, or record again"),
    Cause("row_numbers", "the estimate's timestamps are row numbers (0, 1, 2, ...), those of the "
          "groundtruth times",
          "write the times of the poses, or omit the column and give --frame-rate"),
    Cause("degrees", "{owner} positions are probably longitude and latitude: two axes extend over "
          "{extent:.2g}, where the {other} moves {path_m:.3g} m",
          "convert them to metres, or read them as GNSS fixes"),
    Cause("increments", "the estimate contains the motion since the previous pose instead of "
          "poses: the lengths of its positions correlate by {peak:.2f} with the steps of the "
          "groundtruth", "sum the motions up, and write poses"),
    Cause("few_pairs", "{text}", "{more}"),
    Cause("clock_step", "{owner} clock stepped by {s:+.3f} s at {end_s:.2f} s{number}{proof}",
          "correct the timestamps after it", {"correct": "clock_step"}, of_error=""),
    Cause("both_clocks_step",
          "both clocks stepped by {s:+.3f} s at {end_s:.2f} s{number}: these are two runs",
          "evaluate the time before and after it separately"),
    Cause("clock_offset", "the clocks differ by {offset_s:+.2f} s{known_as}: the correlation of "
          "angular rate and speed is {peak:.2f} with this offset, and {as_stamped:.2f} without",
          "shift the estimate's timestamps", {"time_offset": "{total_s:.3f}"}, of_error=""),
    Cause("other_run", "the motions do not correlate at any clock offset or with any axes "
          "(largest correlation {peak:.2f}): the groundtruth is from another run, or tracking was "
          "lost at the start", "check that both are from the same run: trajeval info SOURCE"),
    Cause("clock_drift",
          "the clock rates differ by {ppm:+.0f} ppm, {growth_ms:+.0f} ms over the run",
          "use one clock for both, or rescale the estimate's timestamps",
          {"estimate.clock_rate": "{ppm:.1f}", "time_offset": "{total_s:.3f}"}, of_error=""),
    Cause("flat", "all {axis} of the {side} are equal, and the {other} moves {height_m:.2g} m "
          "along its vertical axis (rms): the {side} is two-dimensional",
          "measure errors in the plane", {"gauge": "planar"}),
    Cause("groundtruth_held", "the groundtruth repeats every pose for {held_s:.2f} s at "
          "{rate_hz:.0f} Hz while the estimate moves", "use the measured groundtruth without "
          "repeated poses: trajeval trajectory SOURCE --motion-filter 1e-6,1e-6 --save-as tum"),
    Cause("groundtruth_frozen", "the groundtruth is frozen for {frozen_s:.1f} s from {at_s:.1f} "
          "s, while the estimate moves {moved_m:.2f} m: the motion capture system lost the body",
          "evaluate the parts before and after this interval: --end {at_s:.1f}, and --start "
          "{after_s:.1f}"),
    Cause("groundtruth_bridged", "the groundtruth is linear for {bridged_s:.1f} s from {at_s:.1f} "
          "s, where the estimate deviates by {bent_m:.2f} m from a line: a dropout was filled by "
          "interpolation (number of such intervals: {stretches:.0f})", "remove the interpolated "
          "poses, or evaluate the parts before and after them: --end {at_s:.1f}, and --start "
          "{after_s:.1f}"),
    Cause("gap_bridged", "--max-gap {max_gap_s:g} interpolates across groundtruth gaps of up to "
          "{longest_s:.1f} s (number: {holes:.0f}), where the estimate deviates by up to "
          "{bent_m:.2f} m from a line; {percent:.0f} % of the poses are affected",
          "reduce the limit", {"max_gap": "0.5"}),
    _GROUNDTRUTH_EVENTS,
    (
        Cause("wxyz", f"{{owner}} quaternions are in the order w, x, y, z, but were read as x, y, "
              f"z, w: {_AGREE}", "read them as w, x, y, z", {"{side}.quaternion_order": "wxyz"},
              of_conventions=True, of_error="rotation"),
        Cause("xyzw", f"{{owner}} quaternions are in the order x, y, z, w, but were read as w, x, "
              f"y, z: {_AGREE}", "read them as x, y, z, w", {"{side}.quaternion_order": "{order}"},
              of_conventions=True, of_error="rotation"),
        Cause("wxyz_transposed", f"{{owner}} quaternions are in the order w, x, y, z and inverse "
              f"(world in body): {_AGREE}", "correct both",
              {"{side}.quaternion_order": "wxyz", "{side}.inverse": "rotations"},
              of_conventions=True, of_error="rotation"),
        Cause("transposed", f"{{owner}} rotations are inverse (world in body), and its positions "
              f"are not: {_AGREE}", "invert the rotations", {"{side}.inverse": "rotations"},
              of_conventions=True, of_error="rotation"),
        Cause("inverse", f"{{owner}} poses are inverse (world in body): {_AGREE}",
              "invert the poses", {"{side}.inverse": "poses"}, of_conventions=True),
        Cause("mirrored", "the axes of one side are left-handed (an axis was flipped, or two were "
              "exchanged): mirrored, short motions agree to {agreement:.0f} % ({as_read:.0f} % as "
              "read)", "flip or exchange axes of the estimate", {"estimate.axes": "{axes}"},
              of_conventions=True, of_error=""),
        Cause("axes_mixed", f"positions and rotations of one side have different axes: {_AGREE}",
              "apply the same conversion to positions and rotations", {"estimate.axes": "{axes}"},
              of_conventions=True, of_error=""),
        Cause("conventions", f"{{owner}} rotations are {{causes}}, and the axes of its positions "
              f"differ from those of its rotations: {_AGREE}", "correct both",
              {"{side}.quaternion_order": "{order}", "{side}.inverse": "{inverse}",
               "estimate.axes": "{axes}"},
              of_conventions=True, of_error=""),
        Cause("convention_tie",
              f"one side's poses are {{causes}}, which this motion can't distinguish: {_AGREE}",
              "check the conventions of the file, and convert it: trajeval trajectory SOURCE "
              "{options}", of_conventions=True, of_error=""),
        Cause("rotations", "the positions agree, and the rotations agree {how}",
              "check how the rotations were computed: {check}", of_conventions=True),
    ),
    Cause("unit", "the {side} is in {unit}: the groundtruth's motions are {scale:.4g} times the "
          "estimate's", "convert its positions to metres", {"{side}.scale": "{factor}"}),
    (
        Cause("groundtruth_up_axis", "{text}", "or align by all rotations",
              {"up": "{ups}", "gauge": "{gauge}"}),
        Cause("up_axis", "the vertical axis of {owner} frame is probably {axis}{called}, within "
              "{off_deg:.0f} deg; this alignment leaves a tilt of {tilt_deg:.0f} deg",
              "set the vertical axis", {"up": "{axes_up}"}, of_conventions=True),
        Cause("up_axis_or_mirrored", "z points down in the frame of one side, as in NED, or its "
              "axes are left-handed; planar motion can't distinguish them",
              "if z points down, set the vertical axis", {"up": "{axes_up}"}, of_conventions=True),
    ),
    Cause("tilted", "the vertical axes of the two frames differ by {tilt_deg:.1f} deg (standard "
          "deviation {sigma_deg:.1f} deg), which this alignment can't correct: at least one frame "
          "is not aligned with gravity", "align by all rotations", {"gauge": "se3"}),
    Cause("scale", "the estimate has a scale error: the groundtruth's motions are {scale:.3g} "
          "times the estimate's, as with a monocular estimator{or_feet}",
          "align with scale{or_convert}", {"gauge": "{gauge}"}),
    Cause("frames_apart", "positions differ by a constant offset of ({offset}) m, which is "
          "{percent:.0f} % of the squared error{kind}",
          "align by translation, unless the offset is an error of the estimate",
          {"gauge": "translation"}),
    Cause("body", "the body frames differ by a constant rotation of {angle_deg:.0f} deg (standard "
          "deviation {rest_deg:.1f} deg): the groundtruth is probably of another body frame, such "
          "as a marker or a camera",
          "apply this pose of the groundtruth's body, or estimate it with --hand-eye auto",
          {"hand_eye": "{pose}"}, of_error="rotation"),
    Cause("twist_body", "{owner} velocities are in the body frame: rotated to the world frame "
          "they differ by {turned_percent:.0f} % from the derivative of its positions, instead of "
          "{off_percent:.0f} %", "write them in the world frame; other errors are not affected"),
    Cause("lever_arm", "the trajectories are of different points of the body: they have a lever "
          "arm of {lever_m:.2f} m (standard deviation {sigma_m:.2g} m)",
          "apply this pose of the groundtruth's body, or estimate it with --hand-eye auto",
          {"hand_eye": "{pose}"}),
    Cause("small_clock_offset", "the clocks of groundtruth and estimate probably differ: short "
          "motions match best with {offset_ms:+.0f} ms {more}added to the estimate's timestamps",
          "shift the estimate's timestamps", {"time_offset": "{total_s:.4f}"}, of_error=""),
    (
        Cause("covariance_order", "the estimate's covariances probably have rotation before "
              "position: the ratios of error and standard deviation are {exchanged:.2g} "
              "(position) and {exchanged_rotation:.2g} (rotation) with exchanged blocks, and "
              "{as_read:.2g} and {as_read_rotation:.2g} as read",
              "write position before rotation"),
        Cause("covariance_degrees", "the rotation covariances of the estimate are probably in "
              "square degrees: their standard deviations are {times:.0f} times the errors, and "
              "those of positions are not", "write them in square radians"),
    ),
    _ESTIMATE_EVENTS,
    (
        Cause("frames_lost", "the estimate has {rate_hz:.1f} of {of_hz:.0f} poses per second: "
              "frames were lost or not processed",
              "reduce the load of the computer, or the rate of the sensor"),
        Cause("keyframes", "the estimate has {rate_hz:.1f} poses per second at irregular times; "
              "if these are keyframes, which are optimised later, the error differs from the "
              "error of the live output",
              "evaluate the pose of every frame to measure the live output"),
    ),
)
# fmt: on


def _ranked() -> dict[str, Cause]:
    groups = [(item,) if isinstance(item, Cause) else item for item in _BY_SEVERITY]
    return {
        cause.name: replace(cause, rank=len(groups) - row)
        for row, group in enumerate(groups)
        for cause in group
    }


CAUSES: Mapping[str, Cause] = _ranked()
DISCONTINUITIES = frozenset(
    [
        "clock_step",
        "both_clocks_step",
        *(one.name for one in (*_GROUNDTRUTH_EVENTS, *_ESTIMATE_EVENTS)),
    ]
)


def cause_name(kind: str, side: str) -> str:
    """Return the cause of discontinuities of a kind and side, or a name that is no cause."""
    if kind == CLOCK_STEP:
        return "both_clocks_step" if side == BOTH else kind
    return {ESTIMATE: kind, GROUNDTRUTH: f"{GROUNDTRUTH}_{kind}"}.get(side, UNDECIDED)
