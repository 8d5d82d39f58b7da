"""The Parquet tables of a comparison, written from its records group by group."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.batch.plan import PlannedRun
from trajeval_ros.batch.records import Record
from trajeval_ros.batch.results_table import (
    ATE,
    AVAILABLE,
    CALIBRATION,
    CONSISTENCY,
    FAILED,
    INTEGRITY,
    LIKELIHOOD,
    MISSING,
    OK,
    POOLED,
    QUANTILES,
    RE,
    STATISTICS,
    state_of,
    write_pooled,
    write_table,
)
from trajeval_ros.batch.source_hash import hash_of_package
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.valid_poses import dropped_in_words
from trajeval_ros.io.writing import refused_by_disk, write_text
from trajeval_ros.metrics.relative_evaluation import PER_LENGTH
from trajeval_ros.metrics.statistics import quantile, statistics_of

RUNS, POOLED_FILE = "runs.parquet", "pooled.parquet"
GATES, GATES_JSON = "gates.md", "gates.json"
RESULT = "result.json"  # of an evaluation, which a comparison may show
REPORT, PAGES, FIGURES = "report.html", "report", "figures"
_AVAILABLE = (
    *("position_m", "rotation_deg", "age_error_m", "age_error_deg"),
    *("age_s", "latency_s", "interval_s"),
)
_ABSOLUTE = ("position_m", "rotation_deg", "yaw_deg", "tilt_deg")
_ABOUT = "README.txt"
_MADE_BY = "Made by trajeval compare."
_ABOUT_TEXT = f"""\
{_MADE_BY}
runs.parquet    a row per run x metric x length, with inputs and settings
pooled.parquet  statistics over trials, by algorithm and sequence
report.html, tables.*  report and tables; gates.md and gates.json with a
                       baseline
figures/        figures of the report
runs/, inputs.json     finished runs, which are not evaluated again
"""


class FinishedRun(NamedTuple):
    """A run after its evaluation."""

    run: PlannedRun
    planned_key: str  # hash of all inputs of its evaluation; "" for a missing run
    # Key of its record, which differs if a common time span cut the run; "" without a record.
    key: str
    reason: str = ""  # why it has no record
    # Share of the groundtruth's duration that the whole run covers, if a common time span cut it;
    # None for the value in its record.
    own_coverage: float | None = None
    common_share: float = 1.0  # share of the groundtruth's duration that the common time span has


@dataclass(frozen=True, eq=False)
class FinishedComparison:
    """All runs of a comparison after their evaluation."""

    title: str
    settings: dict[str, Any]  # settings that the numbers depend on, as in `Plan.settings`
    runs: Sequence[FinishedRun]  # the runs, in the order of the tables

    @property
    def state(self) -> str:
        """Hash of all inputs of the tables; "" if a run failed that may succeed next time."""
        if any(not item.key and not item.run.missing for item in self.runs):
            return ""
        digest = hashlib.sha256(
            json.dumps([hash_of_package(), self.title, self.settings]).encode()
        )
        for item in self.runs:
            run = item.run
            part = (
                run.algorithm, run.sequence, run.trial, run.groundtruth, run.estimate,
                run.missing, item.planned_key,
            )  # fmt: skip
            digest.update(json.dumps(part).encode())
        return digest.hexdigest()

    def is_in(self, folder: Path) -> bool:
        """Return whether the tables in a folder belong to these runs."""
        return has_tables(folder) and state_of(folder / RUNS) == self.state

    def write_tables(self, folder: Path, record_of: Callable[[FinishedRun], Record]) -> None:
        """Write `runs.parquet` and `pooled.parquet`; memory holds the runs of one group."""
        with refused_by_disk(f"the folder {folder}"):
            for name in (GATES, GATES_JSON):  # belong to the previous tables
                (folder / name).unlink(missing_ok=True)
        write_text(folder / _ABOUT, _ABOUT_TEXT)
        pooled: list[dict[str, Any]] = []

        def rows() -> Iterator[dict[str, Any]]:
            groups = groupby(self.runs, lambda item: (item.run.algorithm, item.run.sequence))
            for (algorithm, sequence), group in groups:
                records = []
                count = 0
                for item in group:
                    count += 1
                    if not item.key:
                        yield row_of_failure(item.run, item.reason)
                        continue
                    record = record_of(item)
                    records.append(record)
                    yield from rows_of_run(item, record)
                pooled.extend(pooled_rows(algorithm, sequence, count, records))

        state = self.state
        write_table(folder / RUNS, rows(), self.title, self.settings, state)
        write_pooled(folder / POOLED_FILE, pooled, self.title, self.settings, state)


def require_own(folder: Path) -> None:
    """Check that the results in a folder were written by a comparison, which replaces them."""
    about = folder / _ABOUT
    try:
        with about.open("rb") as file:
            if file.read(len(_MADE_BY)) == _MADE_BY.encode():
                return
    except OSError:
        pass
    names = (
        *(RESULT, _ABOUT, RUNS, POOLED_FILE, REPORT, GATES, GATES_JSON),
        *("tables.md", "tables.tex", PAGES, FIGURES),
    )
    paths = (folder / name for name in names)
    for path in (*paths, *folder.glob("ate_*.csv"), *folder.glob("re_*.csv")):
        if path.exists() and not path.is_symlink():  # a link is replaced, its target is not
            raise InputError(
                f"{path} is not from a comparison, which replaces it; choose another "
                "--output, or move it away"
            )


def has_tables(folder: Path) -> bool:
    """Return whether a folder has both tables, of the same runs, without failed ones."""
    state = state_of(folder / RUNS)
    return bool(state) and state_of(folder / POOLED_FILE) == state


def rows_of_run(finished: FinishedRun, record: Record) -> Iterator[dict[str, Any]]:
    """Yield the rows of an evaluated run; coverage is that of a common time span that cut it."""
    evaluated = record.run
    association, alignment = evaluated["association"], evaluated["alignment"]
    gap = association["longest_gap"] or {}
    inputs = record.result["provenance"]["inputs"]
    groundtruth, estimate = (
        inputs[record.result["groundtruth"]["source"]],
        inputs[evaluated["estimate"]["source"]],
    )
    coverage, span = (
        association[f"groundtruth_{name}"] / (finished.common_share or 1.0)
        for name in ("coverage", "span")
    )
    run, before = finished.run, finished.own_coverage
    same = {
        **_names(run),
        "status": OK,
        "pairs": association["pairs"],
        "estimate_coverage": association["estimate_coverage"],
        "groundtruth_coverage": coverage,
        "own_groundtruth_coverage": coverage if before is None else before,
        "common_span": finished.common_share,
        "span_s": (record.span_ns[1] - record.span_ns[0]) / 1e9,
        "groundtruth_span": span,
        "longest_gap_s": gap.get("duration_s"),
        "longest_gap_m": gap.get("reach_m"),
        "longest_gap_deg": gap.get("turn_deg"),
        "scale": alignment["scale"],
        "states_used": alignment["states_used"],
        "poses": evaluated["estimate"]["poses"],
        "groundtruth": run.groundtruth,
        "estimate": run.estimate,
        "groundtruth_sha256": groundtruth,
        "estimate_sha256": estimate,
        "key": record.key,
        "warnings": "\n".join(_warnings(evaluated)),
        "diagnosis": ",".join(diagnosi["cause"] for diagnosi in evaluated["diagnosis"]),
    }
    yield from _rows(evaluated["ate"], {**same, "kind": ATE})
    yield from _values(evaluated, same)
    available = evaluated["as_available"] or {}
    statistics = {name: available.get(name) for name in _AVAILABLE}
    yield from _rows(statistics, {**same, "kind": AVAILABLE})
    relative = evaluated["re"]
    if relative is None:
        return
    for length, segment in zip(record.lengths, relative["segments"], strict=True):
        sizes = {name: segment.get(name) for name in ("length_m", "duration_s", "mean_length_m")}
        yield from _rows(segment, {**same, **sizes, "kind": RE, "length": length})
    yield from _rows(relative["pooled"], {**same, "kind": POOLED})


def _warnings(evaluated: dict[str, Any]) -> list[str]:
    """Return the texts of the remarks, after the number of dropped poses."""
    kept = evaluated["estimate"]["poses"]
    dropped = dropped_in_words(evaluated["association"]["dropped"], kept)
    texts = [remark["text"] for remark in evaluated["remarks"]]
    return [dropped, *texts] if dropped else texts


def _values(evaluated: dict[str, Any], same: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield rows of calibration, consistency, integrity and likelihood."""
    calibration, consistency, probabilistic = (
        evaluated[name] or {} for name in ("calibration", "consistency", "probabilistic")
    )
    available = evaluated["as_available"] or {}
    offset, hand_eye = calibration.get("time_offset") or {}, calibration.get("hand_eye") or {}
    rotation, lever = hand_eye.get("rotation") or {}, hand_eye.get("lever_arm") or {}
    joint, per_pose = (consistency.get(name) or {} for name in ("joint", "per_pose"))
    ate = probabilistic.get("ate") or {}
    values = (
        (CALIBRATION, "time_offset_s", offset.get("value_s") if offset.get("applied") else None,
         offset.get("sigma_s")),
        (CALIBRATION, "rotation_deg", rotation.get("angle_deg") if rotation.get("applied") else
         None, None),
        (CALIBRATION, "lever_arm_m", math.hypot(*(item or 0.0 for item in lever["value_m"]))
         if lever.get("applied") else None, None),
        (CALIBRATION, "parameters_applied", calibration.get("parameters_applied"), None),
        (CONSISTENCY, "joint_nees_per_dof", joint.get("nees_per_dof"), None),
        (CONSISTENCY, "pose_nees_per_dof", per_pose.get("mean"), None),
        *_integrity(evaluated["integrity"] or {}),
        (AVAILABLE, "available_percent", available.get("available_percent"), None),
        (LIKELIHOOD, "nll_per_pose", probabilistic.get("nll_per_pose"), None),
        (LIKELIHOOD, "weighted_m", ate.get("weighted_m"), None),
        (LIKELIHOOD, "supported_m", ate.get("supported_m"), None),
        (LIKELIHOOD, "supported_share", ate.get("supported_share"), None),
    )  # fmt: skip
    for kind, metric, value, sigma in values:
        if value is not None:
            yield {**same, "kind": kind, "metric": metric, "mean": value, "std": sigma}


def _integrity(values: dict[str, Any]) -> Iterator[tuple[str, str, float, None]]:
    """Yield kind, metric and value of the integrity, by part of the pose."""
    for part in values.get("parts", ()):
        name = part["part"]
        yield INTEGRITY, f"{name}_hazardous", part["areas"]["hazardous"], None
        yield INTEGRITY, f"{name}_available", part["availability"], None
        yield INTEGRITY, f"{name}_inflation", part["inflation_999"], None
        yield INTEGRITY, f"{name}_level_{part['unit']}", part["protection_level_median"], None


def row_of_failure(run: PlannedRun, reason: str) -> dict[str, Any]:
    """Return the row of a failed or missing run, which has no numbers."""
    return {
        **_names(run),
        "status": MISSING if run.missing else FAILED,
        "reason": reason,
        "groundtruth": run.groundtruth,
        "estimate": run.estimate,
    }


def _names(run: PlannedRun) -> dict[str, str]:
    return {"algorithm": run.algorithm, "sequence": run.sequence, "trial": run.trial}


def _rows(metrics: dict[str, Any], same: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for metric, statistics in metrics.items():
        if isinstance(statistics, dict):
            yield {**same, "metric": metric, **statistics}


def pooled_rows(
    algorithm: str, sequence: str, trials: int, records: Sequence[Record]
) -> Iterator[dict[str, Any]]:
    """Yield the statistics over trials.

    Absolute errors: statistics of the RMSE of the trials. Relative errors: statistics over the
    sub-trajectories of all trials. Rows have the number of expected trials and of those with the
    error.
    """
    same = {"algorithm": algorithm, "sequence": sequence, "trials": trials}
    for metric in _ABSOLUTE:
        item = [record.run["ate"][metric] for record in records]
        values = np.array([one["rmse"] for one in item if one is not None])
        row = {**same, "kind": ATE, "metric": metric, "evaluated": len(values)}
        yield from _statistics_rows(values, row)
    for length in dict.fromkeys(length for record in records for length in record.lengths):
        yield from _relative(length, records, same)


def _relative(
    length: str, records: Sequence[Record], same: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    having = [record for record in records if length in record.lengths]
    segments = [record.run["re"]["segments"][record.lengths.index(length)] for record in having]
    row = {**same, "kind": RE, "length": length, "length_m": segments[0].get("length_m")}
    # Errors in percent refer to the length of each trial, which may differ between trials.
    for metric, (share, unit) in PER_LENGTH.items():
        # Trials without orientations, or with withheld rotation errors, have no column.
        known = [
            (segment.get("length_m"), record.columns[f"{length}.{metric}"])
            for record, segment in zip(having, segments, strict=True)
            if f"{length}.{metric}" in record.columns
        ]
        if not known:
            continue
        of_metric = {**row, "metric": metric, "evaluated": len(known)}
        sizes, errors = zip(*known, strict=True)
        absolute = list(_statistics_rows(np.concatenate(errors), of_metric))
        yield from absolute
        if None in sizes:
            continue
        if len(set(sizes)) == 1:
            yield from (_scaled(item, share, unit / sizes[0]) for item in absolute)
        else:
            shares = [unit / size * column for size, column in known]
            yield from _statistics_rows(np.concatenate(shares), {**of_metric, "metric": share})


def _scaled(row: dict[str, Any], metric: str, factor: float) -> dict[str, Any]:
    """Return the row of the same errors in another unit."""
    in_unit = {name: row[name] * factor for name in (*STATISTICS, *QUANTILES)}
    return {**row, "metric": metric, **in_unit}


def _statistics_rows(values: Floats, row: dict[str, Any]) -> Iterator[dict[str, Any]]:
    ordered = np.sort(values)
    statistics = statistics_of(ordered)
    if statistics is not None:
        quantiles = {name: quantile(ordered, share) for name, share in QUANTILES.items()}
        yield {**row, **vars(statistics), **quantiles}
