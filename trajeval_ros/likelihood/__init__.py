"""How likely an estimate is, given a groundtruth with its uncertainty: section III of the paper.

The generalised relative error (`relative`), the generalised absolute error to first order
(`first_order`) and exactly (`marginal`), in all gauges. Groundtruth is a `Belief`; perturbations
and residuals are twists on the right, translation first.
"""
