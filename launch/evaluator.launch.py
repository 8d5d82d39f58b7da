"""Start the live evaluator.

ros2 launch trajeval_ros evaluator.launch.py groundtruth_topic:=/mocap/pose \
    estimate_topics:=/vio/odometry,/slam/path
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# Parameters of the node that are arguments, too; what is empty is left to params_file.
PARAMETERS = {
    "groundtruth_topic": "Topic of the groundtruth, or /tf:PARENT.CHILD.",
    "estimate_topics": "Topics of the estimates, with commas between them.",
    "modality": "The sensors: mono, stereo-inertial, ... Empty: alignment by SE(3).",
    "output": "Folder for the results. Empty: trajeval_DATE-TIME in the working directory.",
    "rerun": "none, file, serve, serve:ADDRESS:PORT, or connect:URL.",
    "use_sim_time": "Take the time from /clock.",
}


def generate_launch_description() -> LaunchDescription:
    """Return the evaluator with its parameters."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value="",
                description="The node's parameters; config/evaluator.yaml lists them.",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="The node's namespace."
            ),
            DeclareLaunchArgument(
                "name", default_value="evaluator", description="The node's name."
            ),
            *(
                DeclareLaunchArgument(name, default_value="", description=description)
                for name, description in PARAMETERS.items()
            ),
            OpaqueFunction(function=evaluator),
        ]
    )


def evaluator(context: LaunchContext) -> list[Node]:
    """Return the node, with what was given on the command line over what its file says."""
    words = {name: LaunchConfiguration(name).perform(context) for name in PARAMETERS}
    given = {name: word for name, word in words.items() if word}
    if "estimate_topics" in given:
        topics = given["estimate_topics"].strip("[] ").split(",")
        given["estimate_topics"] = [each.strip(" '\"") for each in topics]
    if "use_sim_time" in given:
        given["use_sim_time"] = given["use_sim_time"].lower() == "true"
    file = LaunchConfiguration("params_file").perform(context)
    return [
        Node(
            package="trajeval_ros",
            executable="evaluator",
            namespace=LaunchConfiguration("namespace"),
            name=LaunchConfiguration("name"),
            output="screen",
            # Evaluating a long run at the end takes longer than launch waits by itself.
            sigterm_timeout="30",
            sigkill_timeout="30",
            parameters=[*([file] if file else []), *([given] if given else [])],
        )
    ]
