"""Start the live evaluator: ros2 launch trajeval_ros evaluator.launch.py params_file:=FILE."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the evaluator with a file of parameters."""
    parameters = PathJoinSubstitution(
        [FindPackageShare("trajeval_ros"), "config", "evaluator.yaml"]
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file", default_value=parameters, description="The node's parameters."
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="Take the time from /clock."
            ),
            Node(
                package="trajeval_ros",
                executable="evaluator",
                name="evaluator",
                output="screen",
                emulate_tty=True,
                # Evaluating a long run at the end takes longer than launch waits by itself.
                sigterm_timeout="30",
                sigkill_timeout="30",
                parameters=[
                    LaunchConfiguration("params_file"),
                    {"use_sim_time": LaunchConfiguration("use_sim_time")},
                ],
            ),
        ]
    )
