"""Results of version 0.2, schema `trajeval/1`, in the form of this version."""

from __future__ import annotations

from typing import Any

from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.io.requests.setting import AUTO
from trajeval_ros.io.requests.settings_table import settings_of
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.request import Request

EARLIER = "trajeval/1"
_SUB_TRAJECTORIES = {
    "rule": "sub_trajectory_rule",
    "every": "sub_trajectory_step",
    "path": "sub_trajectory_path",
    "tolerance": "sub_trajectory_tolerance",
    "pairs": "sub_trajectories",
}
_RENAMED = {"lever_m": "lever_arm", "mends": "corrections", "fix": "correct"}


def of_version_0_2(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of result.json of version 0.2 with the fields and settings of this one.

    Version 0.2 stated only a part of the settings: the others are those that its runs report.

    Raises:
        LookupError, TypeError: The content is damaged.
    """
    provenance, first = content["provenance"], content["runs"][0]
    stated, pairs, alignment = provenance["settings"], first["association"], first["alignment"]
    found = {_RENAMED.get(name, name): value for name, value in stated.items()}
    found |= {new: stated["selection"][old] for old, new in _SUB_TRAJECTORIES.items()}
    span = stated["time_span"] and TimeSpan(**stated["time_span"])
    calibration = first["calibration"] or {}
    found |= {
        "protocol": provenance["protocol"],
        "gauge": alignment["gauge"],
        "modality": alignment["modality"],
        "align_states": alignment["states"],
        "association": AUTO if pairs["method"] == "linear" else pairs["method"],
        "max_time_difference": pairs["max_time_difference_s"],
        "max_gap": pairs["max_gap_s"],
        "time_offset": AUTO if calibration.get("time_offset") else pairs["time_offset_s"],
        "ate_form": first["ate"]["form"],
        "re_form": (first["re"] or {}).get("form", Protocol().re_form),
        "correct": stated["fix"] or "",
    }
    defaults = settings_of(Request(time_span=span))
    settings = {name: found.get(name, default) for name, default in defaults.items()}
    runs = [_run(each) for each in content["runs"]]
    return {**content, "runs": runs, "provenance": {**provenance, "settings": settings}}


def _run(run: dict[str, Any]) -> dict[str, Any]:
    remarks = [
        {"level": "warning", "code": "version_0_2", "text": each} for each in run["warnings"]
    ]
    new = {"stream": None, "as_available": None, "corrected": [], "remarks": remarks,
           "events": [], "segments": [], "ate_of_segments_m": None}  # fmt: skip
    return {**run, **new}
