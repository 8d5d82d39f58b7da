"""What needs a ROS 2 environment: the only room that imports `rclpy` and message packages."""
