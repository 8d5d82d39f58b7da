"""An estimator of one's own instead of those of `make demo-real`."""
