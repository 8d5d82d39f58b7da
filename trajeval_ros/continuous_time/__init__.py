"""A groundtruth at any time, with its uncertainty: section IV of the probabilistic paper.

`trajectory.fit_trajectory` is the way in; `piecewise_gp` is its default model.
"""
