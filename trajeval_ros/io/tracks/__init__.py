"""Recordings of feature tracks and an IMU, with groundtruth."""
