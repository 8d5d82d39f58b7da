"""Consistency tests: do the errors fit the estimator's covariances, in the gauge of the errors?

A covariance belongs to a gauge, and so do errors, to that of the alignment. The normalised
estimation error squared (NEES) of errors in one gauge with covariances of another is invalid: it
rejects consistent estimators and accepts others. Here covariances are first transformed to the
alignment's gauge.
"""
