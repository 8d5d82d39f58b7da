"""Start the live evaluator: ros2 launch trajeval_ros evaluator.launch.py params_file:=FILE."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
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
                "use_sim_time",
                default_value="",
                description="Take the time from /clock; empty for what params_file says.",
            ),
            OpaqueFunction(function=evaluator),
        ]
    )


def evaluator(context: LaunchContext) -> list[Node]:
    """Return the node, with what was given on the command line over what its file says."""
    use_sim_time = LaunchConfiguration("use_sim_time")
    given = [{"use_sim_time": use_sim_time}] if use_sim_time.perform(context) else []
    return [
        Node(
            package="trajeval_ros",
            executable="evaluator",
            name="evaluator",
            output="screen",
            emulate_tty=True,
            # Evaluating a long run at the end takes longer than launch waits by itself.
            sigterm_timeout="30",
            sigkill_timeout="30",
            parameters=[LaunchConfiguration("params_file"), *given],
        )
    ]
