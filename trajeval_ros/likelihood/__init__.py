"""Likelihood of an estimate given an uncertain groundtruth (probabilistic paper, section III).

It has the generalised relative error (`relative_density`) and the generalised absolute error
(`marginal`) for all gauges. Groundtruth is a `Belief`. Perturbations and residuals are twists on
the right, translation first.
"""
