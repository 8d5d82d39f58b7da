"""Real lidar odometry with a simulated lidar: `make demo-real`."""
