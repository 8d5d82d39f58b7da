"""Measurements beside evo, in one run on one machine: `make bench`."""
