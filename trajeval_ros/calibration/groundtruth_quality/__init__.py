"""Errors of a groundtruth, measured with the IMU of the same rig, and their correction.

`examine.examine` returns a verdict per cause and the repaired groundtruth of the IMU. W is the
groundtruth's world, M its body (the marker), I the IMU: R_WM = R_WI R_IM, p_WM = p_WI + R_WI l.
IMU time = groundtruth time + offset + skew (groundtruth time - middle).
"""
