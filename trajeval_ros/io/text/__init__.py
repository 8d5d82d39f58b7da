"""Trajectories in text files."""
