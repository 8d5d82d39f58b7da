"""Simulated motion, sensors and odometry, without an estimator.

The estimator's own simulated runs are in `papers/flight.py`.
"""
