"""The part that needs ROS 2: the only subpackage that imports `rclpy` and message packages."""
