"""The `integrity` block of result.json."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import Integrity


def integrity_json(integrity: Integrity) -> dict[str, Any]:
    """Return fractions, episodes and statistics for every part of the pose (docs/result.md)."""
    return {
        "risk": integrity.risk,
        "exactness": integrity.exactness,
        "parts": [
            {
                "part": part.part,
                "unit": part.unit,
                "alert_limit": part.alert_limit,
                "areas": part.areas,
                "episodes": part.episodes,
                "availability": part.availability,
                "bounded": part.bounded,
                "inflation_999": part.inflation,
                "effective_number": part.effective,
                "hazardous_95": list(part.hazardous_95),
                "time_to_alert": {
                    "median_s": part.time_to_alert.median,
                    "worst_s": part.time_to_alert.worst,
                    "episodes": len(part.time_to_alert.seconds) + part.time_to_alert.missed,
                    "missed": part.time_to_alert.missed,
                },
                "error_median": float(np.median(part.errors)),
                "protection_level_median": float(np.median(part.levels)),
            }
            for part in integrity.parts
        ],
    }
