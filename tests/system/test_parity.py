"""evo and rpg_trajectory_evaluation, number by number, on data/parity."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
import parity
import parity_calls
import pytest
from paths import ROOT

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import NoMatchError
from trajeval_ros.metrics.evaluation import evaluate_pairs

ROWS = parity_calls.rows()
Groups = dict[tuple[str, ...], list[parity.Row]]


class DisagreementError(Exception):
    """All of these numbers are different."""


def by(rows: list[parity.Row], *attributes: str) -> Groups:
    groups: Groups = defaultdict(list)
    for row in rows:
        groups[tuple(getattr(row, attribute) for attribute in attributes)].append(row)
    return groups


COMPARED = [row for row in ROWS if row.unanswered is None]
BY_PAIR = by(COMPARED, "pair", "tool")
REPAIRED = [row for row in COMPARED if row.repaired]

UNANSWERED = {
    ("evo", parity_calls.REFUSED): 9,
    ("rpg", parity_calls.DEFECT): 48,
    ("rpg", parity_calls.TOO_FEW): 24,
}


def test_every_number_is_compared_or_counted_here() -> None:
    assert Counter(row.tool for row in COMPARED) == {"evo": 838, "rpg": 1224}
    assert Counter((row.tool, row.unanswered) for row in ROWS if row.unanswered) == UNANSWERED


@pytest.mark.slow
@pytest.mark.parametrize("pair", ["five_poses", "car_kitti"])
def test_the_command_gives_these_numbers(pair: str, tmp_path: Path) -> None:
    settings = {row.setting for row in COMPARED if row.pair == pair and row.setting is not None}
    assert len(settings) > 0
    for setting in settings:
        result = tmp_path / "result.json"
        assert main([*setting.words(pair, tmp_path), "--quiet", f"--json={result}"]) == 0
        (run,) = json.loads(result.read_text(encoding="utf-8"))["runs"]
        for metric, actual in parity.evaluated(pair, setting).ate.items():
            assert run["ate"][metric] == (None if actual is None else dataclasses.asdict(actual))


@pytest.mark.parametrize("name", parity.REFERENCES["files_sha256"])
def test_files_are_those_that_the_numbers_are_of(name: str) -> None:
    content = (parity.FOLDER / "pairs" / name).read_bytes()
    assert hashlib.sha256(content).hexdigest() == parity.REFERENCES["files_sha256"][name]


@pytest.mark.slow
def test_files_are_what_the_generator_writes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks.parity_pairs", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True)
    assert len(parity.REFERENCES["files_sha256"]) > 0
    for name in parity.REFERENCES["files_sha256"]:
        kept, again = (
            np.loadtxt(folder / name, ndmin=2) for folder in (parity.FOLDER / "pairs", tmp_path)
        )
        # Another C library may round the last decimal, and coordinates of 5e6 m, differently.
        last_decimal = 1e-4 if name.startswith("few_digits") else 1e-9
        np.testing.assert_allclose(again, kept, rtol=2.0**-52, atol=1.001 * last_decimal)


@pytest.mark.slow
@pytest.mark.parametrize("group", BY_PAIR, ids="-".join)
def test_numbers_are_the_programs(group: tuple[str, str]) -> None:
    different = [text for row in BY_PAIR[group] if (text := row.disagreement())]
    assert different == []


@pytest.mark.xfail(strict=True, raises=DisagreementError, reason=parity.REPAIRED)
def test_matrices_are_used_as_they_are_in_the_file() -> None:
    different = [text for row in REPAIRED if (text := row.disagreement(of_raw=False))]
    if different:
        raise DisagreementError(*different)


@pytest.mark.parametrize("tool", ["evo", "rpg"])
def test_rotations_that_positions_hardly_determine_are_the_programs_with_a_warning(
    tool: str,
) -> None:
    setting = next(
        row.setting
        for row in COMPARED
        if row.pair == "straight_flat" and row.tool == tool and row.setting is not None
        if row.setting.gauge == "se3" and row.setting.align_states is None
    )
    evaluation = parity.evaluated("straight_flat", setting)
    assert evaluation.alignment.undetermined
    assert evaluation.ate["rotation_deg"] is not None
    actual = dataclasses.replace(evaluation.protocol, name="ours")
    withheld = evaluate_pairs(
        evaluation.association, evaluation.groundtruth, evaluation.estimate, actual
    )
    assert withheld.ate["rotation_deg"] is None


def test_fewer_than_two_sub_trajectories_are_no_zeros() -> None:
    too_few = [row for row in ROWS if row.unanswered == parity_calls.TOO_FEW]
    assert too_few
    for row in too_few:
        actual = row.computed()
        assert actual is None or (actual.count == 1 and actual.rmse > 0.0), str(row)


def test_where_evo_finds_no_match_there_is_none() -> None:
    refused = [
        row
        for row in ROWS
        if row.unanswered == parity_calls.REFUSED
        and row.entry["error"].startswith("SyncException")
    ]
    assert {row.pair for row in refused} == {"limit_stamps", "half_period"}
    for row in refused:
        assert row.setting is not None
        with pytest.raises(NoMatchError):
            parity.evaluated(row.pair, row.setting)


def test_where_evo_finds_no_pairs_of_states_there_are_none() -> None:
    refused = [row for row in ROWS if row.unanswered == parity_calls.REFUSED and row.relative]
    assert len(refused) == 6
    for row in refused:
        assert row.setting is not None
        (segments,) = parity.evaluated(row.pair, row.setting).relative or ()
        assert len(segments.errors.ends) == 0
        assert set(segments.statistics.values()) == {None}
