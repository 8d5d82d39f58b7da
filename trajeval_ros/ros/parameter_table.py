"""All parameters and services of the evaluator's node: names, defaults and help."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.io.requests.setting import NODE, Setting, as_text
from trajeval_ros.io.requests.settings_table import SETTINGS
from trajeval_ros.online.alarms import LIMITED_QUANTITIES

SERVICE_TYPE = "std_srvs/srv/Trigger"
SAVE, RESET, START, STOP, PAUSE = "~/save", "~/reset", "~/start", "~/stop", "~/pause"
SERVICES = {
    SAVE: "Writes the results now. Answers when result.json is written, with its path.",
    RESET: "Ends the run, whose results are written, and starts a new run in a new folder.",
    STOP: "Ends the run, and drops messages until ~/start. Answers when result.json is written.",
    PAUSE: "Drops messages until ~/start. The run stays.",
    START: "Starts a new run in a new folder after ~/stop, and continues the run after ~/pause.",
}
RESET_RUN = "reset"
ON_JUMP = (RESET_RUN, "ignore")


@dataclass(frozen=True)
class NodeParameter:
    """A parameter as it is declared."""

    name: str
    default: str | float | bool | list[str]  # also defines the type
    description: str  # for the user
    range: tuple[float, float] | None = None  # smallest and largest value of a number
    is_live: bool = False  # whether it may be set while the node runs
    choices: tuple[str, ...] = ()  # all values; () if others are possible

    @classmethod
    def of(cls, setting: Setting) -> NodeParameter:
        """Return the parameter for a setting of a request; empty or 0 is its default."""
        default = setting.default if setting.node_default is None else setting.node_default
        if default is None:
            default = "" if setting.kind is str else 0.0
        return cls(
            setting.name,
            as_text(default) if setting.kind is str else default,
            setting.node_help or setting.text,
            setting.range,
            setting.is_live,
            setting.node_choices or setting.choices,
        )


PARAMETERS = (
    NodeParameter("groundtruth_topic", "",
        "Topic of the groundtruth: PoseStamped, PoseWithCovarianceStamped, TransformStamped, "
        "PointStamped, NavSatFix or Odometry, or a transform as in /tf:map.base_link. Required "
        "unless watch is set."),
    NodeParameter("estimate_topics", [""],
        "Topics of the estimates: poses, as above, or nav_msgs/Path. Required."),
    *(NodeParameter.of(item) for item in SETTINGS.values() if NODE in item.verbs),
    NodeParameter("window", "30s",
        "Window of the published ATE: the newest 30s, 50m or 500 (pairs); 0 is the whole run. "
        "Results on disk always cover the whole run.",
        is_live=True),
    NodeParameter("max_delay", 10.0,
        "Largest delay of an estimate relative to newer groundtruth, and of a fix or point "
        "relative to newer estimates, in seconds. 0: limited by a buffer of 500 000 states (44 "
        "MB per estimate).",
        (0.0, 86400.0)),
    NodeParameter("on_time_jump", "reset",
        "Action when timestamps step back by more than one second, as in a bag played in a "
        "loop. reset: the run ends, and another one starts in a new folder. ignore: older poses "
        "are excluded from live values.",
        choices=ON_JUMP),
    NodeParameter("on_restart", "ignore",
        "Action when an estimate restarts or makes a large step: reset or ignore.",
        choices=ON_JUMP),
    NodeParameter("publish_rate", 25.0,
        "Rate of evaluation and publication of the errors of pairs, in Hz.",
        (1.0, 200.0), is_live=True),
    NodeParameter("output", "",
        "Output folder for states, result.json and figures. Empty: trajeval_DATE-TIME in the "
        "working directory."),
    NodeParameter("label", "",
        "Name of the next run, for result.json. Set it before ~/start or ~/reset.",
        is_live=True),
    NodeParameter("metadata", [""],
        "Facts about the next run for result.json, as in operator=Ann,site=hall 2.",
        is_live=True),
    NodeParameter("autosave_period", 30.0,
        "Shortest period of writing result.json, in seconds. It increases (with a message) if "
        "the evaluation takes more than 5 % of a core. 0: only at the end.",
        (0.0, 86400.0), is_live=True),
    NodeParameter("rerun", "none",
        "Output for Rerun: none; file (run.rrd in the output folder); serve or serve:PORT "
        "(file, and a server for viewers on this machine); serve:ADDRESS:PORT (a server for the "
        "network, as in serve:0.0.0.0:9876); connect:URL (file, and a connection to a viewer). "
        "Needs rerun-sdk."),
    NodeParameter("rerun_points", "",
        "Topic of a PointCloud2 in the body of the first estimate, drawn in Rerun: 2500 points of "
        "two scans per second, such as the scans that a lidar odometry has undistorted. Scans "
        "older than 60 s are hidden. Empty: none."),
    NodeParameter("broadcast_tf", False,
        "Alignment published on /tf, from the groundtruth frame to the estimate frame. The "
        "estimate frame must have no other parent, and the gauge must have no scale."),
    NodeParameter("transform_tolerance", 0.2,
        "Time added to the timestamp of the alignment on /tf, in seconds, so that it is known at "
        "the time of newer messages.",
        (0.0, 10.0)),
    NodeParameter("watch_factor", 0.0,
        "Factor on the limits of the watch, as of trajeval watch --factor: 1 for a good VIO. "
        "Alarms of the first estimate are published on ~/event and /diagnostics; groundtruth is "
        "optional. 0: off.",
        (0.0, 1000.0)),
    NodeParameter("watch_with", [""],
        "Topics of second estimates of the same robot, to compare with the first one. Frame, "
        "body and scale may differ."),
    NodeParameter("imu_topic", "",
        "Topic of the robot's IMU (sensor_msgs/Imu), to compare with the first estimate. Its "
        "axes may differ."),
    NodeParameter("map_to_odom", "",
        "Transform from the map to the frame of the first estimate, as in /tf:map.odom, or a "
        "topic of it. Its corrections are monitored."),
    NodeParameter("snapshot_service", "",
        "Service of rosbag2's recorder in snapshot mode, as /rosbag2_recorder/snapshot, called "
        "on an alarm, at most once a minute. Needs rosbag2_interfaces. Empty: off."),
    *(
        NodeParameter(
            f"limits_{name}",
            "",
            f"Limits{unit and f', in {unit},'} of the largest {words} since the last status, for "
            "warnings and errors, as in 0.5,1.0; one number is for errors. 0 or empty: no limit.",
            is_live=True,
        )
        for name, words, unit in LIMITED_QUANTITIES
    ),
    NodeParameter("limits_rate_hz", "",
        "Lower limits of the rate of the estimate's messages, in Hz, for warnings and errors, as "
        "in 18,10; one number is for errors. Empty: no limit.",
        is_live=True),
    NodeParameter("limits_coverage", "0.9,0.5",
        "Lower limits of the fraction of the estimate's poses with groundtruth, or of fixes and "
        "points with an estimate, for warnings and errors; one number is for errors.",
        is_live=True),
)  # fmt: skip


_LIST = "\n".join(
    f"* `{parameter.name}` "
    f"({parameter.default if parameter.default not in ('', ['']) else 'empty'}): "
    f"{parameter.description}{' Can be set during the run.' if parameter.is_live else ''}"
    for parameter in PARAMETERS
)
HELP = f"""Evaluates estimates against groundtruth, live on the robot.

All settings are ROS parameters:

    ros2 run trajeval_ros evaluator --ros-args \\
        -p groundtruth_topic:=/mocap/pose \\
        -p estimate_topics:=[/vio/odometry,/slam/path] \\
        -p modality:=stereo-inertial

    ros2 run trajeval_ros evaluator --ros-args \\
        --params-file evaluator.yaml -r /odom:=/vio/odometry

Parameters and defaults:

{_LIST}

The node publishes errors, the alignment and aligned paths in `~/ESTIMATE/`, and `/diagnostics`.
Its services are {", ".join(f"`{name}`" for name in SERVICES)}. It writes states,
result.json, errors.npz and figures to the output folder. Stop it with Ctrl-C. After a crash, run
`trajeval finish FOLDER`.
"""
