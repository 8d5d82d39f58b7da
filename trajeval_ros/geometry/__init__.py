"""Rigid motions, trajectories and gauges: what everything else computes with."""
