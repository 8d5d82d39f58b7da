"""Start one evaluator per robot; every robot has its own namespace and output folder.

ros2 launch trajeval_ros three_robots.launch.py robots:=robot1,robot2,robot3 \
    groundtruth_topic:=mocap/pose estimate_topics:=vio/odometry

Topics without a leading slash are those of the robot.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, ThisLaunchFileDir

PASSED_ON = ("groundtruth_topic", "estimate_topics", "modality", "use_sim_time", "params_file")


def generate_launch_description() -> LaunchDescription:
    """Return one evaluator per robot."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "robots",
                default_value="robot1,robot2,robot3",
                description="Namespaces of the robots, with commas between them.",
            ),
            DeclareLaunchArgument(
                "output",
                default_value="trajeval",
                description="Folder; each robot has a folder in it.",
            ),
            *(
                DeclareLaunchArgument(name, default_value="", description="As for one robot.")
                for name in PASSED_ON
            ),
            OpaqueFunction(function=evaluators),
        ]
    )


def evaluators(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return the launch file of one evaluator, once per robot."""
    robots = LaunchConfiguration("robots").perform(context).split(",")
    output = LaunchConfiguration("output").perform(context)
    passed_on = [(name, LaunchConfiguration(name)) for name in PASSED_ON]
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource([ThisLaunchFileDir(), "/evaluator.launch.py"]),
            launch_arguments=[*passed_on, ("namespace", robot), ("output", f"{output}/{robot}")],
        )
        for robot in map(str.strip, robots)
        if robot
    ]
