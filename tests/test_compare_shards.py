"""A comparison in shards: what is merged is what one job makes, byte for byte."""

from __future__ import annotations

import shutil
from itertools import chain
from pathlib import Path

import pytest
from comparison_runs import here, write_run, write_runs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")

import pyarrow
import pyarrow.parquet

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.plan import Plan, PlannedRun
from trajeval_ros.batch.record_store import RECORDS, SUFFIX
from trajeval_ros.batch.records import HEAD_BYTES
from trajeval_ros.batch.shards import SHARD, Shard, merged
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.request import Request


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eleven runs of three sequences: one is shorter, one fails, one is missing."""
    folder = tmp_path_factory.mktemp("shards")
    config = write_runs(folder, ["hall", "yard", "loft"])
    write_run(folder / "good" / "hall_trial0.txt", 1.01, count=200, seconds=12.0)
    (folder / "bad" / "yard_trial0.txt").write_text("no trajectory\n")
    (folder / "bad" / "loft_trial1.txt").unlink()
    return config


@pytest.fixture(scope="module")
def whole(config: Path) -> dict[bool, dict[str, bytes]]:
    """What one job makes, on whole runs and on common time spans."""
    made = {}
    for cut in (False, True):
        out = config.parent / f"whole{cut}"
        assert compare(config, out, cut=cut) == 0
        made[cut] = contents(out)
    return made


@pytest.fixture(scope="module")
def whole_shard(config: Path) -> Path:
    """The folder of a comparison's only shard."""
    folder = config.parent / "whole_shard"
    run_plan(plan_of(config, {}), folder, here, shard=Shard(1, 1))
    return folder


def compare(config: Path, out: Path, *options: str, cut: bool) -> int:
    span = "--common-time-span" if cut else "--whole-runs"
    return main(
        ["compare", str(config), "--workers", "1", "-q", "--output", str(out), span, *options]
    )


def contents(out: Path) -> dict[str, bytes]:
    """Return the results, but what is remembered of inputs, and the records."""
    return {
        str(each.relative_to(out)): each.read_bytes()
        for each in out.rglob("*")
        if each.is_file() and each.name != "inputs.json" and each.suffix != SUFFIX
    }


def evaluate_shards(config: Path, count: int, *, cut: bool) -> list[Path]:
    folders = []
    for number in range(1, count + 1):
        folders.append(config.parent / "shards" / str(number))
        plan = plan_of(config, {}, common_time_span=cut)
        run_plan(plan, folders[-1], here, shard=Shard(number, count))
    return folders


@pytest.mark.slow
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), count=st.integers(1, 14), cut=st.booleans())
def test_shards_together_are_the_whole(
    config: Path,
    whole: dict[bool, dict[str, bytes]],
    count: int,
    cut: bool,
    data: st.DataObject,
) -> None:
    shutil.rmtree(config.parent / "shards", ignore_errors=True)
    shutil.rmtree(config.parent / "merged", ignore_errors=True)
    folders = evaluate_shards(config, count, cut=cut)
    given_order = map(str, data.draw(st.permutations(folders)))
    out = config.parent / "merged"
    assert main(["compare", "--merge", *given_order, "--output", str(out), "--quiet"]) == 0
    assert contents(out) == whole[cut]
    for folder in folders:  # a file of records each, and none where nothing could be evaluated
        assert len(list((folder / RECORDS).iterdir())) <= 1
    # The merged folder is one like any other: nothing is evaluated again.
    progress = run_plan(plan_of(config, {}, common_time_span=cut), out, here)
    assert progress.done == 0
    assert contents(out) == whole[cut]


@given(
    runs=st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("stuvw")), max_size=40),
    count=st.integers(1, 50),
    cut=st.booleans(),
)
def test_each_run_is_in_one_shard_and_shards_are_as_large_as_each_other(
    runs: list[tuple[str, str]], count: int, cut: bool
) -> None:
    planned = [PlannedRun(*names, str(trial)) for trial, names in enumerate(runs)]
    plan = Plan("", tuple(planned), Request(Protocol()), cut)
    places = [Shard(number, count).places(plan) for number in range(1, count + 1)]
    assert sorted(chain.from_iterable(places)) == list(range(len(runs)))
    if cut:
        sequences = [{runs[place][1] for place in each} for each in places]
        assert sum(map(len, sequences)) == len({sequence for _, sequence in runs})
    else:
        sizes = [len(each) for each in places]
        assert max(sizes) - min(sizes) <= 1


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/3", "1/3/4", "²/3"])
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="write I/N with I from 1 to N"):
        Shard.parse(text)


def test_shards_that_do_not_belong_together_are_refused(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (1, 2):
        run_plan(plan_of(config, {}), tmp_path / str(number), here, shard=Shard(number, 3))
    shutil.copytree(tmp_path / "2", tmp_path / "again")
    run_plan(plan_of(config, {"gauge": "yaw"}), tmp_path / "yaw", here, shard=Shard(3, 3))
    run_plan(plan_of(config, {}), tmp_path / "two", here, shard=Shard(2, 2))
    (tmp_path / "none").mkdir()
    for folders, said in (
        (["1", "2"], "missing: 3/3 of 3 shards; run them, or give their folders"),
        (["1", "2", "again"], "again are both shard 2/3; give only one"),
        (["1", "2", "yaw"], "have different settings; run the shards again"),
        (["1", "two"], "the shards have different totals, 2 and 3"),
        (["1", "none"], "no finished shard in"),
    ):
        names = [str(tmp_path / each) for each in folders]
        assert main(["compare", "--merge", *names, "--output", str(tmp_path / "out")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
        assert not (tmp_path / "out" / "runs.parquet").exists()


def test_a_shard_that_is_evaluated_again_is_not_finished_meanwhile(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of(config, {})
    run_plan(plan, tmp_path, here, shard=Shard(1, 2))
    assert (tmp_path / SHARD).exists()

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("trajeval_ros.batch.comparison.write_shard", stop)
        with pytest.raises(KeyboardInterrupt):
            run_plan(plan, tmp_path, here, shard=Shard(1, 2))
    assert not (tmp_path / SHARD).exists()
    assert run_plan(plan, tmp_path, here, shard=Shard(1, 2)).done == 0


def test_a_damaged_record_is_refused_by_the_merge_and_replaced_by_its_shard(
    config: Path,
    whole: dict[bool, dict[str, bytes]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = plan_of(config, {})
    folders = [tmp_path / "1", tmp_path / "2"]
    for number, folder in enumerate(folders, 1):
        run_plan(plan, folder, here, shard=Shard(number, 2))
    (file,) = (folders[1] / RECORDS).iterdir()
    data = bytearray(file.read_bytes())
    data[HEAD_BYTES + 10] ^= 1
    file.write_bytes(data)
    command = ["compare", "--merge", *map(str, folders), "--output", str(tmp_path / "out"), "-q"]
    assert main(command) == 2
    assert "can't be read; run its shard again" in capsys.readouterr().err
    assert run_plan(plan, folders[1], here, shard=Shard(2, 2)).done == 1
    assert main(command) == 0
    assert contents(tmp_path / "out") == whole[False]


def test_a_shard_that_cannot_be_read_is_named_once(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / SHARD
    command = ["compare", "--merge", str(tmp_path), "--output", str(tmp_path / "out")]
    table.mkdir()
    assert main(command) == 2
    assert capsys.readouterr().err == f"trajeval: {table} can't be read: is a directory\n"
    table.rmdir()
    run_plan(plan_of(config, {}), tmp_path, here, shard=Shard(1, 1))
    whole = table.read_bytes()
    for damaged in (b"", whole[:-20], whole[:4] + bytes(400) + whole[404:]):
        table.write_bytes(damaged)
        assert main(command) == 2
        said = f"trajeval: {table} is damaged; run that shard again\n"
        assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, None) for name in ("shard", "title", "settings", "runs", "plan", "package")),
        ("shard", "1"),
        ("shard", "2/1"),
        ("runs", "x"),
        ("runs", "0"),
        ("runs", "0.5"),
        ("settings", "{"),
        ("settings", "3"),
    ],
)
def test_a_shard_with_a_damaged_head_is_refused(
    whole_shard: Path, tmp_path: Path, name: str, value: str | None
) -> None:
    table = pyarrow.parquet.read_table(whole_shard / SHARD)
    head = dict(table.schema.metadata)
    del head[f"trajeval.{name}".encode()]
    if value is not None:
        head[f"trajeval.{name}"] = value
    pyarrow.parquet.write_table(table.replace_schema_metadata(head), tmp_path / SHARD)
    with pytest.raises(InputError, match="is damaged; run that shard again"):
        merged([tmp_path])


@pytest.mark.parametrize("value", [None, "x", 0.5, [1]])
@pytest.mark.parametrize("name", ["place", "algorithm", "planned_key"])
def test_a_shard_with_a_damaged_column_is_refused(
    whole_shard: Path, tmp_path: Path, name: str, value: object
) -> None:
    if (name, value) in (("algorithm", "x"), ("planned_key", "x")):
        value = None
    table = pyarrow.parquet.read_table(whole_shard / SHARD)
    place = table.column_names.index(name)
    kind = table.schema.field(name) if value is None and name != "place" else name
    column = pyarrow.array([value] * len(table), getattr(kind, "type", None))
    pyarrow.parquet.write_table(table.set_column(place, kind, column), tmp_path / SHARD)
    with pytest.raises(InputError, match="is damaged; run that shard again"):
        merged([tmp_path])
    pyarrow.parquet.write_table(table.drop([name]), tmp_path / SHARD)
    with pytest.raises(InputError, match="is damaged; run that shard again"):
        merged([tmp_path])


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        ("13", "run 13 of 13 is missing in the shards; run the"),
        (str(10**30), f"run 13 of {10**30} is missing in the shards"),
        ("11", "the shards have 12 runs instead of 11; run the"),
    ],
)
def test_runs_that_are_missing_or_too_many_are_refused(
    whole_shard: Path, tmp_path: Path, runs: str, said: str
) -> None:
    table = pyarrow.parquet.read_table(whole_shard / SHARD)
    head = {**table.schema.metadata, b"trajeval.runs": runs}
    pyarrow.parquet.write_table(table.replace_schema_metadata(head), tmp_path / SHARD)
    with pytest.raises(InputError, match=said):
        merged([tmp_path])


def test_usage_is_refused_in_one_line(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, out = str(config), str(tmp_path / "out")
    for arguments, said in (
        ([one, one], "more than one configuration; give one"),
        ([one, "--shard", "1/2", "--figure-format", "pdf"], "--shard evaluates runs only"),
        ([one, "--shard", "1/2", "--merge"], "--shard evaluates runs only"),
        ([one, "--merge", "--gauge", "yaw"], "--merge uses the settings of the shards"),
        ([one, "--merge", "--workers", "2"], "--merge uses the settings of the shards"),
    ):
        assert main(["compare", *arguments, "--output", out]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line


def test_what_a_shard_did_is_told(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "compare",
        str(config),
        "--workers",
        "1",
        "--shard",
        "3/3",
        "--output",
        str(tmp_path),
    ]
    assert main(command) == 0
    said = capsys.readouterr()
    assert said.out == f"shard 3/3: 3 runs evaluated, 0 unchanged: {tmp_path}\n"
    assert said.err == (
        "warning: 1 of 4 runs of shard 3/3 failed; the tables after --merge list the reasons\n"
    )
