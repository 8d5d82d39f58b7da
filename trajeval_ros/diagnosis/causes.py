"""All causes: name, severity, message, advice and the option that corrects the mistake.

A test returns a cause by name with its numbers (`Seen`). The texts are here.
docs/diagnosis.md explains every cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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
    """A mistake in the input, with its texts."""

    name: str  # a stable identifier, for `--correct` and for programs
    rank: float  # severity; causes that invalidate other tests have the largest values
    sentence: str  # the mistake and its evidence, a format string for the numbers
    advice: str  # instruction for the user, a format string
    # What corrects it, format strings by option of `evaluate` or by attribute of `Corrections`;
    # empty if neither does.
    correction: Mapping[str, str] = field(default_factory=dict)
    # Whether the poses have another convention than the reader assumed.
    of_conventions: bool = False
    # The ATE that its correction reduces: `position`, `rotation`, or "" for either.
    of_error: str = "position"


_AGREE = "corrected, short motions agree to {agreement:.0f} % instead of {as_read:.0f} %"
_UNALIKE = "the motions do not correlate at any clock offset or with any axes"
_OTHER_RUN = f"{_UNALIKE} (largest correlation {{peak:.2f}}): the "
_OTHER_RUN += "groundtruth is from another run, or tracking was lost at the start"

_TABLE = (
    Cause(
        "identical",
        10.0,
        "estimate and groundtruth are identical: {percent:.0f} % of the positions {where} are "
        "equal",
        "give the file or topic of the estimator: --estimate SOURCE",
    ),
    Cause(
        "same_estimate",
        9.8,
        "the estimate is identical to {other}: all poses are equal",
        "give another file or topic: --estimate SOURCE",
    ),
    Cause(
        "stands_still",
        9.5,
        "the {side} does not move, while the {other} moves {path_m:.3g} m",
        "check the positions and the topic of the {side}: trajeval info SOURCE",
    ),
    Cause(
        "diverged",
        9.4,
        "the estimate diverges from {at_s:.1f} s on{until}: it moves {moved_m:.3g} m while the "
        "groundtruth moves {true_m:.3g} m",
        "evaluate the part before it",
        {"end": "{at_s:.3f}"},
    ),
    Cause(
        "diverged_at_start",
        9.4,
        "the estimate diverges from the start{until}: it moves {moved_m:.3g} m while the "
        "groundtruth moves {true_m:.3g} m",
        "check the initialisation of the estimator",
    ),
    Cause(
        "frozen",
        9.3,
        "the estimate repeats its pose for {lost_s:.1f} s from {at_s:.1f} s on{number}, while the "
        "groundtruth moves {true_m:.2f} m and {true_deg:.0f} deg",
        "evaluate the part before it",
        {"end": "{at_s:.3f}"},
    ),
    Cause(
        "frozen_at_start",
        9.3,
        "the estimate repeats its first pose for {lost_s:.1f} s{number}, while the groundtruth "
        "moves {true_m:.2f} m and {true_deg:.0f} deg",
        "evaluate the part after it",
        {"start": "{after_s:.3f}"},
    ),
    Cause(
        "stamps_rounded",
        9.0,
        "{owner} timestamps are rounded to {step_s:g} s: {poses_per_stamp:.0f} different "
        "poses per timestamp",
        "write timestamps with all digits",
    ),
    Cause(
        "swapped",
        8.8,
        "groundtruth and estimate are probably swapped: {groundtruth} is given as groundtruth, "
        "{estimate} as the estimate",
        "exchange -g and -e",
    ),
    Cause(
        "duplicated",
        8.6,
        "{percent:.0f} % of {owner} poses occur twice, {rows_apart:.0f} rows apart: a part "
        "was recorded twice",
        "remove the second copy, or record again",
    ),
    Cause(
        "row_numbers",
        8.55,
        "the estimate's timestamps are row numbers (0, 1, 2, ...), those of the groundtruth times",
        "write the times of the poses, or omit the column and give --frame-rate",
    ),
    Cause(
        "degrees",
        8.54,
        "{owner} positions are probably longitude and latitude: two axes extend over "
        "{extent:.2g}, where the {other} moves {path_m:.3g} m",
        "convert them to metres, or read them as GNSS fixes",
    ),
    Cause(
        "increments",
        8.53,
        "the estimate contains the motion since the previous pose instead of poses: the lengths "
        "of its positions correlate by {peak:.2f} with the steps of the groundtruth",
        "sum the motions up, and write poses",
    ),
    Cause(
        "flat",
        6.6,
        "all {axis} of the {side} are equal, and the {other} moves {height_m:.2g} m along its "
        "vertical axis (rms): the {side} is two-dimensional",
        "measure errors in the plane",
        {"gauge": "planar"},
    ),
    Cause("few_pairs", 8.5, "{text}", "{more}"),
    Cause(
        "clock_offset",
        8.0,
        "the clocks differ by {offset_s:+.2f} s{known_as}: the correlation of angular rate and "
        "speed is {peak:.2f} with this offset, and {as_stamped:.2f} without",
        "shift the estimate's timestamps",
        {"time_offset": "{total_s:.3f}"},
        of_error="",
    ),
    Cause(
        "other_run", 7.0, _OTHER_RUN, "check that both are from the same run: trajeval info SOURCE"
    ),
    Cause(
        "clock_drift",
        6.9,
        "the clock rates differ by {ppm:+.0f} ppm, {growth_ms:+.0f} ms over the run",
        "use one clock for both, or rescale the estimate's timestamps",
        {"estimate.clock_rate": "{ppm:.1f}", "time_offset": "{total_s:.3f}"},
        of_error="",
    ),
    Cause(
        "groundtruth_held",
        6.5,
        "the groundtruth repeats every pose for {held_s:.2f} s at {rate_hz:.0f} Hz while the "
        "estimate moves",
        "use the measured groundtruth without repeated poses: trajeval trajectory SOURCE "
        "--motion-filter 1e-6,1e-6 --save-as tum",
    ),
    Cause(
        "groundtruth_frozen",
        6.4,
        "the groundtruth is frozen for {frozen_s:.1f} s from {at_s:.1f} s, while the estimate "
        "moves {moved_m:.2f} m: the motion capture system lost the body",
        "evaluate the parts before and after this interval: --end {at_s:.1f}, and --start "
        "{after_s:.1f}",
    ),
    Cause(
        "groundtruth_bridged",
        6.3,
        "the groundtruth is linear for {bridged_s:.1f} s from {at_s:.1f} s, where the estimate "
        "deviates by {bent_m:.2f} m from a line: a dropout was filled by interpolation "
        "(number of such intervals: {stretches:.0f})",
        "remove the interpolated poses, or evaluate the parts before and after them: --end "
        "{at_s:.1f}, and --start {after_s:.1f}",
    ),
    Cause(
        "gap_bridged",
        6.2,
        "--max-gap {max_gap_s:g} interpolates across groundtruth gaps of up to {longest_s:.1f} "
        "s (number: {holes:.0f}), where the estimate deviates by up to {bent_m:.2f} m from a "
        "line; {percent:.0f} % of the poses are affected",
        "reduce the limit",
        {"max_gap": "0.5"},
    ),
    Cause(
        "wxyz",
        6.0,
        "{owner} quaternions are in the order w, x, y, z, but were read as x, y, z, w: "
        f"{_AGREE}",
        "read them as w, x, y, z",
        {"{side}.quaternion_order": "wxyz"},
        of_conventions=True,
        of_error="rotation",
    ),
    Cause(
        "xyzw",
        6.0,
        "{owner} quaternions are in the order x, y, z, w, but were read as w, x, y, z: "
        f"{_AGREE}",
        "read them as x, y, z, w",
        {"{side}.quaternion_order": "{order}"},
        of_conventions=True,
        of_error="rotation",
    ),
    Cause(
        "wxyz_transposed",
        6.0,
        f"{{owner}} quaternions are in the order w, x, y, z and inverse (world in body): {_AGREE}",
        "correct both",
        {"{side}.quaternion_order": "wxyz", "{side}.inverse": "rotations"},
        of_conventions=True,
        of_error="rotation",
    ),
    Cause(
        "transposed",
        6.0,
        f"{{owner}} rotations are inverse (world in body), and its positions are not: {_AGREE}",
        "invert the rotations",
        {"{side}.inverse": "rotations"},
        of_conventions=True,
        of_error="rotation",
    ),
    Cause(
        "inverse",
        6.0,
        f"{{owner}} poses are inverse (world in body): {_AGREE}",
        "invert the poses",
        {"{side}.inverse": "poses"},
        of_conventions=True,
    ),
    Cause(
        "mirrored",
        6.0,
        "the axes of one side are left-handed (an axis was flipped, or two were exchanged): "
        "mirrored, short motions agree to {agreement:.0f} % ({as_read:.0f} % as read)",
        "flip or exchange axes of the estimate",
        {"estimate.axes": "{axes}"},
        of_conventions=True,
        of_error="",
    ),
    Cause(
        "axes_mixed",
        6.0,
        f"positions and rotations of one side have different axes: {_AGREE}",
        "apply the same conversion to positions and rotations",
        {"estimate.axes": "{axes}"},
        of_conventions=True,
        of_error="",
    ),
    Cause(
        "conventions",
        6.0,
        f"{{owner}} rotations are {{causes}}, and the axes of its positions differ from those of "
        f"its rotations: {_AGREE}",
        "correct both",
        {
            "{side}.quaternion_order": "{order}",
            "{side}.inverse": "{inverse}",
            "estimate.axes": "{axes}",
        },
        of_conventions=True,
        of_error="",
    ),
    Cause(
        "convention_tie",
        6.0,
        f"one side's poses are {{causes}}, which this motion can't distinguish: {_AGREE}",
        "check the conventions of the file, and convert it: trajeval trajectory SOURCE {options}",
        of_conventions=True,
        of_error="",
    ),
    Cause(
        "rotations",
        6.0,
        "the positions agree, and the rotations agree {how}",
        "check how the rotations were computed: {check}",
        of_conventions=True,
    ),
    Cause(
        "unit",
        5.85,
        "the {side} is in {unit}: the groundtruth's motions are {scale:.4g} times the estimate's",
        "convert its positions to metres",
        {"{side}.scale": "{factor}"},
    ),
    Cause(
        "groundtruth_up_axis",
        5.8,
        "{text}",
        "or align by all rotations",
        {"up": "{ups}", "gauge": "{gauge}"},
    ),
    Cause(
        "up_axis",
        5.8,
        "the vertical axis of {owner} frame is probably {axis}{called}, within {off_deg:.0f} "
        "deg; this alignment leaves a tilt of {tilt_deg:.0f} deg",
        "set the vertical axis",
        {"up": "{axes_up}"},
        of_conventions=True,
    ),
    Cause(
        "up_axis_or_mirrored",
        5.8,
        "z points down in the frame of one side, as in NED, or its axes are left-handed; planar "
        "motion can't distinguish them",
        "if z points down, set the vertical axis",
        {"up": "{axes_up}"},
        of_conventions=True,
    ),
    Cause(
        "tilted",
        5.7,
        "the vertical axes of the two frames differ by {tilt_deg:.1f} deg (standard deviation "
        "{sigma_deg:.1f} deg), which this alignment can't correct: at least one frame is not "
        "aligned with gravity",
        "align by all rotations",
        {"gauge": "se3"},
    ),
    Cause(
        "scale",
        5.5,
        "the estimate has a scale error: the groundtruth's motions are {scale:.3g} times the "
        "estimate's, as with a monocular estimator{or_feet}",
        "align with scale{or_convert}",
        {"gauge": "{gauge}"},
    ),
    Cause(
        "frames_apart",
        5.4,
        "positions differ by a constant offset of ({offset}) m, which is {percent:.0f} % of the "
        "squared error{kind}",
        "align by translation, unless the offset is an error of the estimate",
        {"gauge": "translation"},
    ),
    Cause(
        "twist_body",
        4.95,
        "{owner} velocities are in the body frame: rotated to the world frame they differ "
        "by {turned_percent:.0f} % from the derivative of its positions, instead of "
        "{off_percent:.0f} %",
        "write them in the world frame; other errors are not affected",
    ),
    Cause(
        "body",
        5.0,
        "the body frames differ by a constant rotation of {angle_deg:.0f} deg (standard deviation "
        "{rest_deg:.1f} deg): the groundtruth is probably of another body frame, such as a marker "
        "or a camera",
        "apply this pose of the groundtruth's body, or estimate it with --hand-eye auto",
        {"hand_eye": "{pose}"},
        of_error="rotation",
    ),
    Cause(
        "lever_arm",
        4.9,
        "the trajectories are of different points of the body: they have a lever arm of "
        "{lever_m:.2f} m (standard deviation {sigma_m:.2g} m)",
        "apply this pose of the groundtruth's body, or estimate it with --hand-eye auto",
        {"hand_eye": "{pose}"},
    ),
    Cause(
        "small_clock_offset",
        4.8,
        "the clocks of groundtruth and estimate probably differ: short motions match best with "
        "{offset_ms:+.0f} ms {more}added to the estimate's timestamps",
        "shift the estimate's timestamps",
        {"time_offset": "{total_s:.4f}"},
        of_error="",
    ),
    Cause(
        "covariance_order",
        4.0,
        "the estimate's covariances probably have rotation before position: the ratios of "
        "error and standard deviation are {exchanged:.2g} (position) and "
        "{exchanged_rotation:.2g} (rotation) with exchanged blocks, and {as_read:.2g} and "
        "{as_read_rotation:.2g} as read",
        "write position before rotation",
    ),
    Cause(
        "covariance_degrees",
        4.0,
        "the rotation covariances of the estimate are probably in square degrees: their standard "
        "deviations are {times:.0f} times the errors, and those of positions are not",
        "write them in square radians",
    ),
    Cause(
        "frames_lost",
        1.0,
        "the estimate has {rate_hz:.1f} of {of_hz:.0f} poses per second: frames were lost or not "
        "processed",
        "reduce the load of the computer, or the rate of the sensor",
    ),
    Cause(
        "keyframes",
        1.0,
        "the estimate has {rate_hz:.1f} poses per second at irregular times; if these are "
        "keyframes, which are optimised later, the error differs from the error of the live "
        "output",
        "evaluate the pose of every frame to measure the live output",
    ),
)

_SPLIT = "{parts}"
_DROP = {"drop_groundtruth_outliers": FLAG}
_AT, _DURING = "at {end_s:.2f} s{gap}{number}", "at {begin_s:.2f} s{lasting}{number}"
_JUMPS = f"the {{side}} jumped by {{size}} {_AT}, which the {{other}} did not"
_FLIPS = f"the {{side}} rotated by {{deg:.0f}} deg {_DURING}, which the {{other}} did not"
_LEAVES = f"the {{side}} has an outlier of {{size}} {_DURING}"
_HOLDS = (
    "the position of the {side} is frozen from {begin_s:.1f} s{lasting}{number}, while the "
    "{other} moves {m:.2f} m"
)
_BEFORE = "evaluate the part before it"
_OF_GROUNDTRUTH, _OF_ESTIMATE = 6.15, 3.9  # ranks: an error of the estimate is no mistake
_OF_DISCONTINUITIES = (
    Cause(
        "clock_step",
        8.2,
        "{owner} clock stepped by {s:+.3f} s at {end_s:.2f} s{number}{receptions}",
        "correct the timestamps after it",
        {"correct": CLOCK_STEP},
        of_error="",
    ),
    Cause(
        "both_clocks_step",
        8.1,
        "both clocks stepped by {s:+.3f} s at {end_s:.2f} s{number}: these are two runs",
        "evaluate the time before and after it separately",
    ),
    Cause("groundtruth_outlier", _OF_GROUNDTRUTH, _LEAVES, "drop such poses", _DROP, of_error=""),
    Cause("groundtruth_flip", _OF_GROUNDTRUTH, _FLIPS, "drop such poses", _DROP, of_error=""),
    Cause("groundtruth_flip_stays", _OF_GROUNDTRUTH, _FLIPS, _BEFORE, {"end": "{begin_s:.3f}"}),
    Cause("groundtruth_step", _OF_GROUNDTRUTH, _JUMPS, _SPLIT),
    Cause(
        "restart",
        _OF_ESTIMATE,
        f"the estimate restarted at its origin {_AT}: {{size}} that the groundtruth did not move",
        _SPLIT,
    ),
    Cause("step", _OF_ESTIMATE, _JUMPS, _SPLIT),
    Cause("outlier", _OF_ESTIMATE, _LEAVES, "check the estimator there"),
    Cause("flip", _OF_ESTIMATE, _FLIPS, "check the estimator there"),
    Cause("flip_stays", _OF_ESTIMATE, _FLIPS, _BEFORE, {"end": "{begin_s:.3f}"}),
    Cause("frozen_position", _OF_ESTIMATE, _HOLDS, _BEFORE, {"end": "{begin_s:.3f}"}),
)
DISCONTINUITIES = frozenset(cause.name for cause in _OF_DISCONTINUITIES)
CAUSES: Mapping[str, Cause] = {cause.name: cause for cause in (*_TABLE, *_OF_DISCONTINUITIES)}


def cause_name(kind: str, side: str) -> str:
    """Return the cause of discontinuities of a kind and side, or a name that is no cause."""
    if kind == CLOCK_STEP:
        return "both_clocks_step" if side == BOTH else kind
    return {ESTIMATE: kind, GROUNDTRUTH: f"{GROUNDTRUTH}_{kind}"}.get(side, UNDECIDED)
