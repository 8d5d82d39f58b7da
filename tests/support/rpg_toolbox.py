"""How the authors' toolbox names what we compute, and where it slips."""

from __future__ import annotations

METRICS = {
    "trans_m": "position_m",
    "trans_perc": "position_percent",
    "rot_deg": "rotation_deg",
    "rot_deg_per_m": "rotation_deg_per_m",
    "yaw_deg": "yaw_deg",
    "gravity_deg": "tilt_deg",
}
# Its list of starts and ends slips there (its `dropped_index_case`).
SLIPPED = ("vislam_ba/V2_03/7", "8.61")
