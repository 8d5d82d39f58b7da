"""Reading of trajectories and settings, writing of results: all access to files."""
