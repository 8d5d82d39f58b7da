"""Settings of the evaluations under test."""

from __future__ import annotations

from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectories import Length

LENGTHS = (Length(4.0, "m"), Length(2.0, "s"), Length(25.0, "%"))
BASE = Protocol(lengths=LENGTHS)
