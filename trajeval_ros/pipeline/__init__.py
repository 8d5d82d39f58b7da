"""A request and trajectories in, an outcome out."""
