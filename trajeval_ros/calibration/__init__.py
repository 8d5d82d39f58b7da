"""Calibration: clocks and bodies that groundtruth and estimate don't share.

`calibrate.calibrate` estimates, `body.HandEye` applies, `hints` recognises. Nothing here is done
unless somebody asks for it, but for the hints, which change no number.
"""
