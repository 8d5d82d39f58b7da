"""Whether an estimator is as sure as it should be: covariances in the gauge of the errors.

A covariance lives in a gauge, and errors live in that of the alignment. The normalised
estimation error squared (NEES) of one with the covariance of the other accuses honest
estimators and acquits bad ones; here every covariance is first brought to the alignment's gauge.
"""
