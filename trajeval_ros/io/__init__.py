"""Everything that touches files: trajectories in, results out."""
