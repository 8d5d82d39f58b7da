"""Evaluation while the robot moves: pure Python, without ROS, at a constant cost per message."""
