"""The experiments of the papers: the gauge study and the association study.

Nothing below imports them. The estimator of the gauge paper is in `visual_inertial`.
"""
