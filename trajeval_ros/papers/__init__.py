"""The experiments of the papers: the gauge study with its estimator, and the association study.

Zhang, Gallego and Scaramuzza, *On the Comparison of Gauge Freedom Handling in Optimization-Based
Visual-Inertial State Estimation*, RA-L 2018 ("the gauge paper"). Nothing below imports them.
"""
