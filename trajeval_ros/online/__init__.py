"""Live evaluation without ROS, at a constant cost per message."""
