"""Discontinuities of groundtruth and estimate: what jumped, which side, and when."""
