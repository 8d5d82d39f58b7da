"""Groundtruth at any time, with its uncertainty: section IV of the probabilistic paper.

Use `continuous_trajectory.fit_trajectory`. Its default model is in `piecewise_gp`.
"""
