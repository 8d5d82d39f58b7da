"""How likely an estimate is, given a groundtruth with its uncertainty: section III of the paper.

The generalised relative error (`relative_density`) and the generalised absolute error
(`marginal`), in all gauges. Groundtruth is a `Belief`; perturbations
and residuals are twists on the right, translation first.
"""
