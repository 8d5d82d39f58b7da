"""Bags: rosbag2 (sqlite3 and MCAP) and ROS 1, read by column."""
