"""Labels of the metrics in tables and figures, with their units."""

from __future__ import annotations

ABSOLUTE_LABELS = {
    "position_m": "position [m]",
    "horizontal_m": "horizontal [m]",
    "vertical_m": "vertical [m]",
    "rotation_deg": "rotation [deg]",
    "yaw_deg": "yaw [deg]",
    "tilt_deg": "tilt [deg]",
    "velocity_mps": "velocity [m/s]",
    "gyroscope_bias": "gyroscope bias [rad/s]",
    "accelerometer_bias": "accelerometer bias [m/s^2]",
    "rotation_part": "rotation part",
    "full": "full pose",
}
RELATIVE_LABELS = {
    "position_m": "position [m]",
    "position_percent": "position [%]",
    "rotation_deg": "rotation [deg]",
    "rotation_deg_per_m": "rotation [deg/m]",
    "yaw_deg": "yaw [deg]",
    "tilt_deg": "tilt [deg]",
    "velocity_mps": "velocity [m/s]",
    "distance_m": "distance [m]",
    "distance_percent": "distance [%]",
    "rotation_part": "rotation part",
    "full": "full pose",
}
