"""A comparison of runs in object storage: a real server on loopback, from manifest to verdict."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import here, write_run

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("moto.server", reason="moto's server is missing")
pytest.importorskip("s3fs", reason="s3fs is missing")
pytest.importorskip("upath", reason="universal_pathlib is missing")

from object_store import bucket
from upath import UPath

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.config import plan_of
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import data_size

STORE = "s3://runs"
HEADER = "algorithm,sequence,trial,groundtruth,estimate\n"


def fetched(*sizes: int) -> int:
    """Return the bytes of whole objects and of their beginnings, which tell what they are."""
    return sum(sizes) + sum(min(size, 16) for size in sizes)


@pytest.fixture(scope="module")
def wire() -> Iterator[Any]:
    with bucket(STORE) as wire:
        yield wire


@pytest.fixture(scope="module")
def sizes(wire: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:  # noqa: ARG001
    """Put five runs and their manifest into the bucket; one contains no trajectory."""
    folder = tmp_path_factory.mktemp("runs")
    lines = [HEADER]
    for sequence, trials in (("hall", 3), ("yard", 2)):
        write_run(folder / f"truth_{sequence}.txt", count=500)
        for trial in range(trials):
            write_run(folder / f"{sequence}_{trial}.txt", 1.01 + 0.01 * trial)
            lines.append(f"vio,{sequence},{trial},truth_{sequence}.txt,{sequence}_{trial}.txt\n")
    (folder / "hall_1.txt").write_text("no trajectory\n")
    for file in folder.iterdir():
        (UPath(STORE) / file.name).write_bytes(file.read_bytes())
    (UPath(STORE) / "runs.csv").write_text("".join(lines))
    (UPath(STORE) / "far.csv").write_text(HEADER + "vio,hall,0,t.txt,s3://other/e.txt\n")
    return {file.name: file.stat().st_size for file in folder.iterdir()}


@pytest.mark.slow
def test_five_runs_of_which_one_is_poisoned(
    sizes: dict[str, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    options = ["--figures", "0", "--workers", "1", "--output", str(out)]
    command = ["compare", f"{STORE}/runs.csv", *options]
    assert main(command) == 0
    text = capsys.readouterr()
    size = data_size(fetched(*sizes.values()))
    assert (
        f"4 runs evaluated, 1 failed or missing, {size} read from remote stores; report.html"
        in text.out
    )
    reason = f"{STORE}/hall_1.txt is text without a row of numbers; give a file with poses"
    assert f"warning: vio hall 1 failed: {reason}\n" in text.err
    trials = summary_of(out).trials
    assert [trial.status for trial in trials] == ["ok", "failed", "ok", "ok", "ok"]
    # What failed is fetched again, with its groundtruth.
    assert main(command) == 0
    size = data_size(fetched(sizes["hall_1.txt"], sizes["truth_hall.txt"]))
    told = f"4 unchanged, 1 failed or missing, {size} read from remote stores; "
    assert told in capsys.readouterr().out


@pytest.mark.slow
def test_bytes_of_all_runs_are_counted_and_no_more_are_transferred(
    wire: Any, sizes: dict[str, int], tmp_path: Path
) -> None:
    plan = plan_of(f"{STORE}/runs.csv", {"gauge": "yaw"})
    before = wire.carried
    progress = run_plan(plan, tmp_path, here)
    total = sum(sizes.values())
    assert progress.fetched_bytes == fetched(*sizes.values())
    assert total < wire.carried - before < 1.3 * total  # with the headers of all answers


@pytest.mark.slow
@pytest.mark.usefixtures("sizes")
def test_a_manifest_names_no_other_host_than_its_own(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 2 has the remote URL s3://other/e\.txt; if you"):
        plan_of(f"{STORE}/far.csv", {})
    (tmp_path / "runs.csv").write_text(f"{HEADER}vio,hall,0,t.txt,{STORE}/hall_0.txt\n")
    with pytest.raises(InputError, match=f"add --allow-remote {STORE}"):
        plan_of(tmp_path / "runs.csv", {})
    (run,) = plan_of(tmp_path / "runs.csv", {}, allow_remote=[STORE]).runs
    assert run.estimate == f"{STORE}/hall_0.txt"
    with pytest.raises(InputError, match=f"^{STORE}/none.csv does not exist; check the URL"):
        plan_of(f"{STORE}/none.csv", {})
    with pytest.raises(InputError, match=r"is not a manifest .* copy the file to this machine"):
        plan_of(f"{STORE}/runs.yaml", {})


@pytest.mark.slow
@pytest.mark.usefixtures("sizes")
def test_patterns_are_listed_in_a_store(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(
        f"groundtruth: {STORE}/truth_{{sequence}}.txt\nruns:\n"
        f"  vio: {STORE}/{{sequence}}_{{trial}}.txt\nsequences: [hall, yard]\n"
    )
    plan = plan_of(config, {}, allow_remote=[STORE])
    listed = plan_of(f"{STORE}/runs.csv", {})
    assert [run for run in plan.runs if not run.missing] == list(listed.runs)


@pytest.mark.slow
def test_a_store_that_does_not_answer_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    files = UPath("s3://nowhere").fs
    files.clear_instance_cache()
    with pytest.raises(InputError, match=r"^s3://nowhere/runs\.csv can't be read: "):
        plan_of("s3://nowhere/runs.csv", {})
