"""Reading of recordings with feature tracks, IMU and groundtruth."""
