"""No output has a number that the evaluation withholds."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from comparison_runs import compare
from upright_runs import car, erring, standing
from written_trajectories import write

from trajeval_ros.cli.app import main
from trajeval_ros.formatting.numbers import four_digits, significant
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.vertical_axis import up_axis_doubt
from trajeval_ros.metrics import evaluation as metrics
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.premises import Doubts, Premise, relies_on
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.relative_errors import RelativeErrors
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.simulation.drifting_odometry import simulate

PROTOCOL = Protocol(gauge="se3", lengths=("8m", "16m"))
Sides = tuple[Trajectory, Trajectory]


def other_body() -> Sides:
    flight = simulate(seed=3, duration_s=40.0)
    truth = flight.groundtruth[::10]
    rotated = lie.from_rotation_vector(np.array([0.0, 0.0, 1.2]))
    assert truth.quaternions is not None
    quaternions = lie.multiply(truth.quaternions, rotated[None])
    return truth, dataclasses.replace(truth, quaternions=quaternions, covariances=None)


def other_up_axis() -> Sides:
    truth = standing(car(1), "-y", states_axis=False)
    return truth, erring(truth)


def straight() -> Sides:
    truth = car(1)
    along = np.arange(len(truth))[:, None] * np.array([[0.2, 0.0, 0.0]])
    noise = np.random.default_rng(1).normal(scale=0.003, size=along.shape)
    truth = dataclasses.replace(truth, positions=along)
    return truth, dataclasses.replace(truth, positions=along + noise)


CASES = {
    other_body: {Premise.ALIGNMENT_ROTATION, Premise.BODY_ROTATION, Premise.FIRST_STATES},
    other_up_axis: {Premise.UP_AXIS, Premise.RELATIVE_UP_AXIS},
    straight: {Premise.ALIGNMENT_ROTATION},
}


def comparison(
    parquet: ModuleType,
    folder: Path,
    sides: list[str],
    options: list[str],
    withheld: Iterable[str],
    capsys: pytest.CaptureFixture[str],
) -> list[str]:
    """Return the texts that `compare` writes; its gates refuse withheld metrics."""
    output = folder / "compared"
    assert compare(*sides, *options, output=output) == 0
    runs = output / "runs.parquet"
    rows = parquet.read_table(runs).to_pylist()
    assert not [row for row in rows if row["kind"] == "ate" and row["metric"] in withheld]
    for metric in withheld:
        gate = ["--baseline", str(runs), "--fail-if", f"ate.{metric}.rmse worse than 5 %"]
        assert compare(*sides, *options, *gate, output=folder / "gated") == 2
        assert metric in capsys.readouterr().err
    pages = [path for path in output.rglob("*") if path.suffix in {".html", ".md", ".tex", ".csv"}]
    return [path.read_text() for path in pages]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_a_live_evaluator_withholds_the_same_numbers(case: Callable[[], Sides]) -> None:
    truth, estimate = case()
    offline = evaluate(truth, estimate, PROTOCOL)
    live = OnlineEvaluator(OnlineSettings(PROTOCOL))
    live.up_axis_doubt = up_axis_doubt(truth)
    live.add_groundtruth(truth)
    live.add_estimate(estimate)
    update = live.update(at_end=True)
    snapshot = live.snapshot()
    assert snapshot.doubts.reasons.keys() == offline.doubts.reasons.keys()
    assert snapshot.ate.keys() >= {"rotation_deg", "yaw_deg"}
    assert all(snapshot.ate[metric] is None for metric in offline.doubts.withheld(AbsoluteErrors))
    assert bool(snapshot.relative) == bool(update.ends) == (offline.relative is not None)
    [errors] = update.errors
    for metric, values in (
        ("rotation_deg", errors.rotation_deg),
        ("yaw_deg", errors.yaw_deg),
        ("tilt_deg", errors.tilt_deg),
        ("yaw_deg", errors.attitude_deg),
        ("horizontal_m", errors.along_cross_vertical),
    ):
        assert (values is None) == bool(offline.doubts.about(AbsoluteErrors, metric)), metric


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_no_output_has_a_withheld_number(
    case: Callable[[], Sides],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is missing")
    from rrd import Rrd

    for name, side in zip(("truth", "vio"), case(), strict=True):
        write(tmp_path / f"{name}.txt", side)
    sides = [str(tmp_path / f"{name}.txt") for name in ("truth", "vio")]
    output = tmp_path / "out"
    options = ["--gauge", "se3", "--lengths", "8,16", "--output", str(output)]
    picture = tmp_path / "run.rrd"
    assert main(["evaluate", *sides, *options, "--rrd", str(picture)]) == 0
    printed = capsys.readouterr().out
    result = evaluate(*case(), PROTOCOL)
    assert CASES[case] <= result.doubts.reasons.keys()
    [stored] = json.loads((output / "result.json").read_text())["runs"]
    withheld = result.doubts.withheld(AbsoluteErrors)
    relative = result.doubts.withheld(RelativeErrors)
    assert withheld
    assert all(stored["ate"][metric] is None for metric in withheld)
    segments = [] if stored["re"] is None else stored["re"]["segments"]
    assert bool(segments) == ("position_m" not in relative)
    assert all(segment[metric] is None for segment in segments for metric in relative)
    columns = np.load(output / "errors.npz")
    assert not [name for name in columns.files if name.split("/")[-1] in withheld]
    table = parquet.read_table(output / "errors.parquet")
    assert not withheld.keys() & set(table.column_names)
    assert ("drift" in printed.splitlines()[0].replace("drift withheld", "")) == bool(segments)
    scalars = {line for line in Rrd(picture).described().splitlines() if " Scalars:" in line}
    assert any(line.startswith("metrics/ate_position/") for line in scalars)
    rotation = any(line.startswith("metrics/ate_rotation/") for line in scalars)
    assert rotation == ("rotation_deg" not in withheld)
    compared = comparison(parquet, tmp_path, sides, options[:4], withheld, capsys)
    # Without doubts, the evaluation has the numbers that no text may have.
    monkeypatch.setattr(metrics, "doubts_of", lambda *_: Doubts())
    freedom = dataclasses.replace(result.alignment, freedom=None)
    monkeypatch.setattr(metrics, "align_pairs", lambda *_: freedom)
    whole = evaluate(*case(), PROTOCOL)
    secret = {whole.ate[metric] for metric in withheld}
    for part in whole.relative or ():
        secret |= {part.statistics[metric] for metric in relative}
    texts = [printed, *(path.read_text() for path in output.rglob("*.svg"))]
    texts += [path.read_text() for path in output.rglob("*.html")]
    texts += compared
    for statistics in secret - {None}:
        assert statistics is not None
        for number in (statistics.rmse, statistics.mean):
            for digits in (four_digits(number), significant(number, 3)):
                if len(digits) >= 5:
                    assert not any(f" {digits} " in text for text in texts), digits


@pytest.mark.parametrize("kind", [AbsoluteErrors, RelativeErrors])
def test_every_error_declares_what_it_relies_on(kind: type) -> None:
    undeclared = {
        column.name for column in dataclasses.fields(kind) if "premises" not in column.metadata
    }
    assert undeclared <= {"starts", "ends"}


def test_a_new_metric_is_withheld_by_its_declaration() -> None:
    @dataclasses.dataclass(frozen=True)
    class Errors:
        length_m: float = relies_on(required=True)
        sideways_m: float | None = relies_on(Premise.UP_AXIS)

    doubts = Doubts({Premise.UP_AXIS: "z is not up"})
    assert doubts.withheld(Errors) == {"sideways_m": "z is not up"}
    assert doubts.without(Errors(2.0, 1.0)) == Errors(2.0)
