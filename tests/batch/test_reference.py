"""All shared EuRoC runs: the numbers of single evaluations, and of the authors' toolbox."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.executors import local_pool
from trajeval_ros.batch.finished_comparison import POOLED_FILE, RUNS
from trajeval_ros.batch.results_table import STATISTICS, ResultsTable, read_pooled
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import protocol_from
from trajeval_ros.pipeline.pipeline import evaluate

pytestmark = pytest.mark.slow

CONFIG = """\
folder: {folder}
groundtruth: groundtruth/{{sequence}}.txt
runs:
  vio_mono: vio_mono/{{sequence}}.txt
  vislam_ba: vislam_ba/{{sequence}}_trial{{trial}}.txt
"""

Compared = Callable[..., Path]


@pytest.fixture(scope="module")
def compared(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Compared:
    """Return what compares all runs by some settings and gives the folder."""
    folder = tmp_path_factory.mktemp("euroc")
    config = folder / "euroc.yaml"
    config.write_text(CONFIG.format(folder=shared_data / "euroc"))

    def run(**settings: str) -> Path:
        plan = plan_of(config, settings)
        assert len(plan.runs) == 33
        progress = run_plan(plan, folder / "out", lambda: local_pool(2))
        assert progress.failed == 0
        return folder / "out"

    return run


def rows_by_run(folder: Path) -> dict[str, list[dict[str, Any]]]:
    result: dict[str, list[dict[str, Any]]] = {}
    columns = ("kind", "metric", "length", "length_m", "mean_length_m", "count", *STATISTICS)
    names = ("algorithm", "sequence", "trial", "groundtruth", "estimate", "pairs", "scale")
    for row in ResultsTable(folder / RUNS).select((*names, *columns)):
        name = "/".join(filter(None, (row["algorithm"], row["sequence"], row["trial"])))
        result.setdefault(name, []).append(row)
    return result


def settings_of(**message: str) -> dict[str, Any]:
    names = (
        "gauge", "modality", "align_states", "association", "max_time_difference", "max_gap",
        "time_offset", "lengths", "ate_form", "re_form",
    )  # fmt: skip
    return {**dict.fromkeys(names), **message}


def test_every_number_is_that_of_a_single_evaluation(
    compared: Compared, shared_data: Path, recording: Callable[[str], Trajectory]
) -> None:
    result = rows_by_run(compared(modality="mono-inertial"))
    protocol = protocol_from("default", **settings_of(modality="mono-inertial"))
    assert len(result) == 33
    for rows in result.values():
        single = evaluate(
            *(
                recording(str(Path(rows[0][side]).relative_to(shared_data)))
                for side in ("groundtruth", "estimate")
            ),
            protocol,
        )
        expected: dict[tuple[str, str, str | None], Any] = {
            ("ate", metric, None): item for metric, item in single.ate.items() if item
        }
        expected |= {
            ("re", metric, str(segment.length)): statistic
            for segment in single.relative or ()
            for metric, statistic in segment.statistics.items()
            if statistic
        }
        expected |= {("re.pooled", metric, None): item for metric, item in single.pooled.items()}
        assert {(row["kind"], row["metric"], row["length"]) for row in rows} == set(expected)
        for row in rows:
            assert row["pairs"] == len(single.association)
            one = dataclasses.asdict(expected[row["kind"], row["metric"], row["length"]])
            for name, value in one.items():
                assert row[name] == pytest.approx(value, rel=1e-12, abs=1e-15), name


def test_statistics_over_trials_are_the_toolboxs(
    compared: Compared, reference: Callable[[str], Any]
) -> None:
    """Those of single runs are, in tests/system/test_rpg_reference.py."""
    folder = compared(protocol="rpg", gauge="sim3", lengths="none")
    pooled = {
        (row["algorithm"], row["sequence"], row["metric"]): row
        for row in read_pooled(folder / POOLED_FILE)
        if row["kind"] == "ate"
    }
    expected = reference("rpg_toolbox")["multi_trial"]
    assert len(expected) > 0
    for name, multi in expected.items():
        algorithm, sequence = "vislam_ba", name.removeprefix("vislam_ba_")
        for metric, actual, relative in (
            ("trans_m", "position_m", 1e-8),
            ("rot_deg", "rotation_deg", 1e-7),
        ):
            row = pooled[algorithm, sequence, actual]
            theirs = multi["stats_of_rmse_over_trials"][f"sim3_-1|{metric}"]
            assert row["trials"] == row["evaluated"] == multi["n_trials"]
            assert_statistics(row, theirs, relative, 1e-9)


def assert_statistics(
    computed: dict[str, Any], theirs: dict[str, float], relative: float, absolute: float
) -> None:
    assert computed["count"] == theirs["num_samples"]
    for name in ("rmse", "mean", "median", "std", "min", "max"):
        assert computed[name] == pytest.approx(theirs[name], rel=relative, abs=absolute), name


def test_pooled_errors_are_those_of_all_trials_together(
    compared: Compared, recording: Callable[[str], Trajectory]
) -> None:
    folder = compared(modality="mono-inertial")
    protocol = protocol_from("default", **settings_of(modality="mono-inertial"))
    truth = recording("euroc/groundtruth/MH_05.txt")
    all_errors = []
    for trial in range(10):
        estimate = recording(f"euroc/vislam_ba/MH_05_trial{trial}.txt")
        single = evaluate(truth, estimate, protocol)
        assert single.relative is not None
        all_errors.append(single.relative[1].errors.position_m)
    errors = np.concatenate(all_errors)
    (row,) = (
        row
        for row in read_pooled(folder / POOLED_FILE)
        if (row["algorithm"], row["sequence"]) == ("vislam_ba", "MH_05")
        and (row["kind"], row["length"], row["metric"]) == ("re", "16m", "position_percent")
    )
    assert row["count"] == len(errors)
    assert row["rmse"] == pytest.approx(np.sqrt(np.mean(errors**2)) * 100 / 16, rel=1e-12)
    for name, share in {"median": 50, "p5": 5, "p25": 25, "p75": 75, "p95": 95}.items():
        assert row[name] == pytest.approx(np.percentile(errors, share) * 100 / 16, rel=1e-12)
