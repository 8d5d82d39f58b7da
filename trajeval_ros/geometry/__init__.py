"""Rotations, rigid motions, trajectories and gauges."""
