"""Reading and writing of trajectories in text files."""
