"""Watching an estimate without groundtruth: signals, limits of a healthy run, and alarms."""
