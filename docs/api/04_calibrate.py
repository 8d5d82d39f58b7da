"""Groundtruth of a marker by another clock: estimate offset and body, or apply what is known."""

from dataclasses import replace

import numpy as np

from trajeval_ros import CalibrationRequest, HandEye, Protocol, Request, calibrate, run, simulate

flight = simulate(seed=1, duration_s=60.0)
half = np.sqrt(0.5)
marker = HandEye(rotation_xyzw=np.array([0.0, 0.0, half, half]), lever_m=np.array([0.1, 0.0, 0.2]))
# What motion capture would report: the marker's pose, by a clock that is 100 ms ahead.
groundtruth = marker.inverse().of_body(flight.groundtruth)
groundtruth = replace(groundtruth, stamps=groundtruth.stamps + 100_000_000)

calibration = calibrate(groundtruth, flight.estimate, "yaw")
offset = calibration.offset
print("offset, s:", offset.value, "+-", offset.half_width_95, offset.status)
print("rotation:", calibration.rotation.status, calibration.rotation.reason)
print("lever arm:", calibration.lever.status, calibration.lever.reason)

# In an evaluation, only what is significant is applied.
protocol = Protocol(gauge="yaw", lengths=())
request = CalibrationRequest(offset=True, hand_eye=True)
calibrated = run(groundtruth, [flight.estimate], Request(protocol, request)).runs[0].calibrated
print("before:", calibrated.before, "after:", calibrated.after)
known = CalibrationRequest(offset=True, known=marker)
print("known marker:", run(groundtruth, [flight.estimate], Request(protocol, known)).runs[0])
