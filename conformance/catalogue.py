"""What is known of the cases: their kind, what their data do not determine, and a sentence."""

from __future__ import annotations

ASSOCIATION_CASES = (
    "slow_estimate", "fast_estimate", "near_the_limit", "unsorted", "repeated_rows",
    "gap_of_groundtruth", "gap_of_estimate", "partial_overlap", "shortest_rotation", "nanoseconds",
)  # fmt: skip
RELATIVE_CASES = ("relative_walk", "relative_rest", "relative_utm")
KITTI_CASES = ("kitti_drive", "kitti_short_drive")
# Quantities that no data of the case determine: `undetermined` is the only right answer.
UNDETERMINED: dict[str, tuple[str, ...]] = {
    "one_pose": ("rotation_deg.yaw.", "rotation_deg.se3.", "sim3."),
    "two_poses": ("rotation_deg.se3.", "rotation_deg.sim3."),
    "exact_line": ("rotation_deg.se3.", "rotation_deg.sim3.", "rotation_deg.se3_first_10."),
    "motionless_estimate": ("sim3.", "rotation_deg.yaw.", "rotation_deg.se3.")
    + ("rotation_deg.yaw_first_10.", "rotation_deg.se3_first_10."),
    "motionless_groundtruth": ("rotation_deg.yaw.", "rotation_deg.se3.", "rotation_deg.sim3.")
    + ("rotation_deg.yaw_first_10.", "rotation_deg.se3_first_10."),
}
# Quantities with a value that a tool may withhold, because noise or rounding decides it.
UNCERTAIN: dict[str, tuple[str, ...]] = {
    "one_pose": (".yaw.", ".se3."),
    "two_poses": (".yaw.", ".se3.", "sim3."),
    "three_poses": (".yaw.", ".se3.", "sim3."),
    "exact_line": (".se3.", "sim3.", ".se3_first_10.", "rotation_deg.yaw"),
    # The errors are as large as the motion.
    "mirrored_axis": ("rotation_deg.yaw.", "rotation_deg.se3.", "rotation_deg.sim3.")
    + ("rotation_deg.yaw_first_10.", "rotation_deg.se3_first_10."),
    "scale_25": ("rotation_deg.yaw.", "rotation_deg.se3.")
    + ("rotation_deg.yaw_first_10.", "rotation_deg.se3_first_10."),
    "near_line": ("rotation_deg.se3.", "rotation_deg.sim3.", ".se3_first_10."),
    "motionless_estimate": (".yaw.", ".se3.", ".yaw_first_10.", ".se3_first_10."),
    "motionless_groundtruth": (".yaw.", ".se3.", "sim3.", ".yaw_first_10.", ".se3_first_10."),
    "one_outlier": ("rotation_deg.yaw.", "rotation_deg.se3.", "rotation_deg.sim3.", "scale."),
}
ABOUT = {
    "generic": "a random walk; the estimate has noise and a frame of its own",
    "same_frame": "equal frames, so errors without alignment are small",
    "one_pose": "one pose: no rotation and no scale can be fitted",
    "two_poses": "two poses: the rotation about their line is free",
    "three_poses": "three poses with large noise",
    "scale_0_37": "the estimate is smaller by the factor 0.37 of a monocular camera",
    "scale_25": "the estimate is smaller by the factor 25",
    "utm_groundtruth": "the groundtruth has coordinates of 5e5 and 5e6 m",
    "utm_both": "both sides have such coordinates",
    "earth_fixed": "earth-centred coordinates and millimetre errors",
    "mirror": "a reflection fits better than any rotation",
    "mirrored_axis": "the estimate has one axis with the wrong sign",
    "plane": "a level groundtruth",
    "turned_frame": "the frames differ by 2 rad about an oblique axis, which yaw does not align",
    "yaw_near_180_deg": "the frames differ by 180 deg - 1e-9 rad of yaw",
    "near_line": "noise of 1 mm about a line of 10 m: the rotation about it is uncertain",
    "exact_line": "both sides on a line: the rotation about it is free",
    "motionless_estimate": "all estimated positions are equal: no scale exists",
    "motionless_groundtruth": "all groundtruth positions are equal: the best scale is 0",
    "micrometres": "steps of 0.1 micrometres",
    "megametres": "steps of 100 km",
    "no_noise": "no noise of position, and rotation errors of 1e-12 rad",
    "rotation_1e-8_rad": "rotation errors of 1e-8 rad, which an arc cosine loses",
    "rotation_near_180_deg": "rotation errors of 180 deg - 1e-9 rad",
    "quaternion_signs": "the same orientations with quaternions of either sign",
    "quaternions_not_normalised": "norms from 0.996 to 1.006",
    "one_outlier": "one position is wrong by 300 m",
    "negative_zero": "heights that are -0 on both sides",
    "text_forms": "tabs, comments, empty lines, exponents, CR LF, no final line end",
    "keyframes": "poses at irregular times, 0.1 to 3 s apart",
    "slow_estimate": "groundtruth of 40 Hz, estimate of 10 Hz",
    "fast_estimate": "groundtruth of 20 Hz, estimate of 81 Hz: several poses per state",
    "near_the_limit": "time differences of 19.9 and 20.1 ms",
    "unsorted": "rows in random order",
    "repeated_rows": "some rows occur twice",
    "gap_of_groundtruth": "no groundtruth for 1.2 s",
    "gap_of_estimate": "no estimate for 1.2 s",
    "partial_overlap": "the estimate starts earlier and ends later",
    "shortest_rotation": "consecutive quaternions of the groundtruth have opposite signs",
    "nanoseconds": "pairs that differ by less than float64 seconds can represent",
    "relative_walk": "sub-trajectories of a random walk",
    "relative_rest": "sub-trajectories with a rest, in which the path does not grow",
    "relative_utm": "sub-trajectories with coordinates of 5e6 m",
    "kitti_drive": "a drive of 1.4 km, with every length of the KITTI benchmark",
    "kitti_short_drive": "a drive of 0.45 km, too short for half of the lengths",
    "nees": "positions with covariances",
}
