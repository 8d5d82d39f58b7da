"""All parameters and services of the evaluator's node: names, defaults and descriptions."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.geometry.fix_selection import DEFAULT_CORRELATION_S
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.io.requests.request_words import AUTO
from trajeval_ros.online.alarms import LIMITED_QUANTITIES

FROZEN = "frozen"
SERVICE_TYPE = "std_srvs/srv/Trigger"
SAVE, RESET = "~/save", "~/reset"
SERVICES = {
    SAVE: "Writes the results now. Answers when result.json is written, with its path.",
    RESET: "Ends the run, whose results are written, and starts a new run in a new folder.",
}


@dataclass(frozen=True)
class NodeParameter:
    """A parameter as it is declared.

    Attributes:
        name: Its name.
        default: Its default value, which also defines its type.
        description: Its meaning, for the user.
        range: Smallest and largest value of a number.
        is_live: Whether it may be set while the node runs.
    """

    name: str
    default: str | float | bool | list[str]
    description: str
    range: tuple[float, float] | None = None
    is_live: bool = False


PARAMETERS = (
    NodeParameter(
        "groundtruth_topic",
        "",
        "Topic of the groundtruth: PoseStamped, PoseWithCovarianceStamped, TransformStamped, "
        "PointStamped, NavSatFix or Odometry, or a transform as in /tf:map.base_link. Required "
        "unless watch is set.",
    ),
    NodeParameter(
        "estimate_topics",
        [""],
        "Topics of the estimates: poses, as above, or nav_msgs/Path. Required.",
    ),
    NodeParameter(
        "modality",
        "",
        f"Sensors of the estimator; they determine the gauge: {', '.join(MODALITIES)}.",
    ),
    NodeParameter(
        "gauge",
        "",
        "Transformation that the alignment fits, instead of modality: "
        f"{', '.join(each.value for each in Gauge)} (default se3, or yaw for GNSS fixes).",
    ),
    NodeParameter(
        "align_states",
        "all",
        f"States used for the alignment: all, the first N, or {FROZEN} (all, until the alignment "
        "is well determined).",
    ),
    NodeParameter(
        "align_with",
        "positions",
        "Data that determine the rotation of the alignment: positions, or poses to include "
        "orientations, for nearly straight paths.",
    ),
    NodeParameter(
        "window",
        "30s",
        "Window of the published ATE: the newest 30s, 50m or 500 (pairs); 0 is the whole run. "
        "Results on disk always cover the whole run.",
        is_live=True,
    ),
    NodeParameter(
        "lengths",
        "8,16,24,32,40",
        "Sub-trajectory lengths of the relative error: 8,16 (metres), 1s,5s (seconds), 1f,10f "
        "(frames), 10%,20% (of the path, only in final results) or none.",
        is_live=True,
    ),
    NodeParameter(
        "association",
        AUTO,
        "Pairing method: linear interpolates the groundtruth at the estimate's timestamps, "
        f"groundtruth-stamps the estimate at the groundtruth's. {AUTO}: groundtruth-stamps for "
        "NavSatFix and PointStamped, otherwise linear.",
    ),
    NodeParameter(
        "max_gap",
        0.5,
        "Longest gap to interpolate across, in seconds.",
        (0.0, 3600.0),
    ),
    NodeParameter(
        "max_delay",
        10.0,
        "Largest delay of an estimate relative to newer groundtruth, and of a fix or point "
        "relative to newer estimates, in seconds. 0: limited by a buffer of 500 000 states "
        "(44 MB per estimate).",
        (0.0, 86400.0),
    ),
    NodeParameter(
        "time_offset",
        "0",
        f"Offset added to the estimates' timestamps, in seconds, or {AUTO}: estimated from the "
        "first minute, and applied if statistically significant.",
    ),
    NodeParameter(
        "hand_eye",
        "none",
        "Pose of the groundtruth's marker in the estimate's body: none; a YAML file with a "
        "TransformStamped; /tf_static:BODY.MARKER; or auto: estimated from the first minute, "
        "and applied if statistically significant.",
    ),
    NodeParameter(
        "lever_arm",
        "",
        "Position of the groundtruth's antenna or prism in the estimate's body frame, in metres, "
        "as in 0.4,0.2,1.0. For a lever arm from TF use hand_eye, as in "
        "/tf_static:base_link.gps.",
    ),
    NodeParameter(
        "datum",
        "",
        "Origin of the east-north-up frame of GNSS fixes: LAT,LON,HEIGHT in degrees and metres "
        "above the ellipsoid. Empty: the first fix that is used.",
    ),
    NodeParameter(
        "min_fix_status",
        0.0,
        "Lowest status of the fixes that are used: 0 any, 1 satellite-based, 2 ground-based "
        "augmentation.",
        (0.0, 2.0),
    ),
    NodeParameter(
        "max_fix_sigma",
        0.0,
        "Largest horizontal standard deviation of the fixes that are used, in metres, by their "
        "own covariance. 0: no limit.",
        (0.0, 1e6),
    ),
    NodeParameter(
        "fix_correlation",
        DEFAULT_CORRELATION_S,
        "Correlation time of the errors of fixes, in seconds, for the estimate's own error in the "
        "results.",
        (0.001, 1e6),
    ),
    NodeParameter(
        "up",
        "",
        "Vertical axis (x, y, z, -x, -y or -z) of all frames, or of the groundtruth and of the "
        "estimates, as in -y,z. Empty: -y for frames named *_optical and *_optical_frame, "
        "otherwise z. YAML needs quotes for 'y'.",
    ),
    NodeParameter(
        "covariance",
        "none",
        "Consistency test of errors and covariances in the estimates' messages: message, or "
        "none. The NEES of the window is published, the NEES of the whole run is in the "
        "results.",
    ),
    NodeParameter(
        "rotation_covariance_frame",
        "world",
        "Axes of rotation covariances in messages: world, as in ROS, or body.",
    ),
    NodeParameter(
        "groundtruth_noise",
        "",
        "Standard deviations of the groundtruth for NEES, in metres and degrees, as in "
        "0.002,0.1. Empty: zero.",
    ),
    NodeParameter(
        "alert_limit",
        "",
        "Largest acceptable error, for protection levels from the covariances: metres, and "
        "optionally degrees for the heading, as in 0.5,2. Needs covariance message.",
    ),
    NodeParameter(
        "risk",
        1e-5,
        "Probability that an error exceeds its protection level.",
        (1e-12, 0.5),
    ),
    NodeParameter(
        "on_time_jump",
        "segment",
        "Action when timestamps step back by more than one second, as in a bag played in a "
        "loop. segment: new run in the same folder, with its own alignment. reset: new run in "
        "a new folder. ignore: older poses are excluded from live values.",
    ),
    NodeParameter(
        "on_restart",
        "ignore",
        "Action when an estimate jumps, as after a restart with a new origin: segment or ignore.",
    ),
    NodeParameter(
        "publish_rate",
        20.0,
        "Rate of evaluation and publication, in Hz.",
        (1.0, 200.0),
        is_live=True,
    ),
    NodeParameter(
        "output",
        "",
        "Output folder for pairs, result.json and figures. Empty: trajeval_DATE-TIME in the "
        "working directory.",
    ),
    NodeParameter(
        "autosave_period",
        30.0,
        "Shortest period of writing result.json, in seconds. It increases (with a message) if "
        "the evaluation takes more than 5 % of a core. 0: only at the end.",
        (0.0, 86400.0),
        is_live=True,
    ),
    NodeParameter(
        "rerun",
        "none",
        "Output for Rerun: none; file (run.rrd in the output folder); serve or serve:PORT "
        "(file, and a server for viewers on this machine); connect:URL (file, and a "
        "connection to a viewer). Needs rerun-sdk.",
    ),
    NodeParameter(
        "broadcast_tf",
        False,
        "Alignment published on /tf, from the groundtruth frame to the estimate frame. The "
        "estimate frame must have no other parent, and the gauge must have no scale.",
    ),
    NodeParameter(
        "watch",
        "",
        "File with limits, written by trajeval watch --learn. Alarms of the first estimate are "
        "published on ~/event and /diagnostics; groundtruth is optional. Empty: off.",
    ),
    NodeParameter(
        "watch_with",
        [""],
        "Topics of second estimates of the same robot, to compare with the first one. Frame, body "
        "and scale may differ.",
    ),
    NodeParameter(
        "imu_topic",
        "",
        "Topic of the robot's IMU (sensor_msgs/Imu), to compare with the first estimate. Its axes "
        "may differ.",
    ),
    NodeParameter(
        "map_to_odom",
        "",
        "Transform from the map to the frame of the first estimate, as in /tf:map.odom, or a "
        "topic of it. Its corrections are monitored.",
    ),
    NodeParameter(
        "watch_factor",
        2.0,
        "Factor between the largest values of the healthy run and the limits.",
        (1.0, 1000.0),
    ),
    NodeParameter(
        "black_box",
        "",
        "Seconds to record before and after an alarm, as in 30s+10s. Alarms of the watch and "
        "errors above the limits below write such a clip. Empty: off.",
    ),
    NodeParameter(
        "black_box_topics",
        [""],
        "Topics in the clips, of any installed type. Empty: the topics that the node "
        "subscribes to.",
    ),
    NodeParameter(
        "black_box_folder",
        "trajeval_black_box",
        "Folder of the clips of all runs.",
    ),
    NodeParameter(
        "black_box_memory",
        256.0,
        "Limit of memory, in megabytes. Above it the oldest messages are dropped. Writing a clip "
        "may need the same amount again.",
        (1.0, 1e5),
    ),
    NodeParameter(
        "black_box_disk",
        2048.0,
        "Limit of the folder's size, in megabytes. Above it, or above 100 clips, the oldest clips "
        "are deleted.",
        (1.0, 1e7),
    ),
    NodeParameter(
        "black_box_pause",
        60.0,
        "Minimum time between two alarms with a clip or a snapshot, in seconds.",
        (0.0, 86400.0),
    ),
    NodeParameter(
        "snapshot_service",
        "",
        "Service of rosbag2's recorder in snapshot mode, as /rosbag2_recorder/snapshot, called on "
        "an alarm. Needs rosbag2_interfaces. Empty: off.",
    ),
    *(
        NodeParameter(
            f"{level}_{name}",
            0.0,
            f"Limit{unit and f', in {unit},'} of the largest {words} since the last status. "
            f"Above it, diagnostics {reports}. 0: no limit.",
            (0.0, 1e6),
            is_live=True,
        )
        for name, words, unit in LIMITED_QUANTITIES
        for level, reports in (("warn", "warn"), ("error", "report an error"))
    ),
    NodeParameter(
        "warn_coverage",
        0.9,
        "Fraction of the estimate's poses with groundtruth, or of fixes and points with an "
        "estimate, below which diagnostics warn.",
        (0.0, 1.0),
        is_live=True,
    ),
    NodeParameter(
        "error_coverage",
        0.5,
        "Fraction of the estimate's poses with groundtruth, or of fixes and points with an "
        "estimate, below which diagnostics report an error.",
        (0.0, 1.0),
        is_live=True,
    ),
)
