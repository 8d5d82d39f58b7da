"""Calibration of clock offset and body transform between groundtruth and estimate.

`calibrate.calibrate` estimates and `apply.evaluate_calibrated` applies, both only on request.
"""
