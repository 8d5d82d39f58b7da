"""What is to be compared: patterns, folders of other tools, and what a user gets wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from comparison_runs import compare, here, write_run, write_runs

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.finished_comparison import RUNS
from trajeval_ros.batch.patterns import Pattern
from trajeval_ros.batch.plan import Plan, natural
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import SideHints
from trajeval_ros.io.yaml_file import read_mapping
from trajeval_ros.pipeline.pipeline import evaluate


def plan(target: Path, **settings: str) -> Plan:
    return plan_of(target, settings)


def refused(config: Path, text: str) -> str:
    config.write_text(text)
    with pytest.raises(TrajevalError) as error:
        plan(config)
    return str(error.value)


def test_all_trials_of_all_sequences_in_order(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=12, algorithms=["vio"])
    names = [(run.sequence, run.trial) for run in plan(config).runs]
    assert names == [(place, str(trial)) for place in ("hall", "yard") for trial in range(12)]
    assert all(Path(run.estimate).is_file() for run in plan(config).runs)


def test_what_others_have_and_one_lacks_is_missing(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=2)
    (tmp_path / "bad" / "yard_trial1.txt").unlink()
    (tmp_path / "groundtruth" / "hall.txt").unlink()
    missing = {run.name: run.missing for run in plan(config).runs if run.missing}
    assert missing["bad yard 1"] == f"{tmp_path}/bad/yard_trial1.txt does not exist"
    assert missing["good hall 0"] == "no groundtruth of hall"
    assert len(missing) == 5


def test_sequences_and_trials_that_nobody_has_are_missing_as_well(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1)
    with config.open("a") as file:
        file.write("sequences: [yard, roof]\ntrials: [0, 1]\n")
    runs = plan(config).runs
    assert [run.name for run in runs if not run.missing] == ["good yard 0", "bad yard 0"]
    assert len(runs) == 8


def test_settings_are_those_of_evaluate_and_the_command_line_comes_first(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    with config.open("a") as file:
        file.write("modality: mono\nalign_states: 5\nmax_gap: 1\ncommon_time_span: true\n")
    written = plan(config)
    assert written.request.protocol.gauge is Gauge.SIM3
    assert written.request.protocol.align_states == 5
    assert written.request.protocol.association.max_gap_s == 1.0
    assert [str(length) for length in written.request.protocol.lengths] == ["4m", "8m"]
    assert written.common_time_span
    text = plan_of(config, {"gauge": "yaw", "lengths": "10%", "common_time_span": False})
    assert text.request.protocol.gauge is Gauge.YAW
    assert str(text.request.protocol.lengths[0]) == "10%"
    assert not text.common_time_span


def test_a_protocol_can_be_a_file_beside_the_comparison(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    (tmp_path / "ours.yaml").write_text("base: rpg\ngauge: sim3\n")
    with config.open("a") as file:
        file.write("protocol: ours.yaml\n")
    protocol = plan(config).request.protocol
    assert (protocol.name, protocol.gauge, protocol.re_form) == ("ours", Gauge.SIM3, "euler")
    assert plan(config, gauge="yaw").request.protocol.gauge is Gauge.YAW


def test_a_placeholder_takes_as_much_as_it_can_and_a_topic_follows(tmp_path: Path) -> None:
    for name in ("MH_01_3.mcap", "V1_02_10.mcap"):
        (tmp_path / name).write_text("")
    pattern = Pattern.parse("{sequence}_{trial}.mcap:/vio/odometry")
    assert pattern.find(tmp_path) == {
        ("MH_01", "3"): f"{tmp_path}/MH_01_3.mcap:/vio/odometry",
        ("V1_02", "10"): f"{tmp_path}/V1_02_10.mcap:/vio/odometry",
    }


def test_folders_with_characters_that_shells_know(tmp_path: Path) -> None:
    folder = tmp_path / "runs [old] {x}"
    with pytest.raises(TrajevalError, match=r"unknown \{x\}"):
        Pattern.parse("runs {x}/{sequence}.txt")
    config = write_runs(folder)
    assert len(plan(config).runs) == 8


def test_ov_evals_folders(tmp_path: Path) -> None:
    for sequence in ("V1_01", "V1_02"):
        write_run(tmp_path / "truths" / f"{sequence}.txt")
        for trial in ("1_estimate", "2_estimate"):
            write_run(tmp_path / "algorithms" / "mono" / sequence / f"{trial}.txt", 1.01)
    write_run(tmp_path / "algorithms" / "stereo" / "V1_01" / "1_estimate.txt", 1.01)
    runs = plan(tmp_path).runs
    assert [run.name for run in runs if run.missing] == ["stereo V1_02 1_estimate"]
    assert len(runs) == 6
    assert runs[0].groundtruth == str(tmp_path / "truths" / "V1_01.txt")
    write_run(tmp_path / "algorithms" / "mono" / "V1_01" / "1_estimate.csv", 1.01)
    with pytest.raises(TrajevalError, match="two files for the same run"):
        plan(tmp_path)


def test_the_toolboxs_folders(tmp_path: Path) -> None:
    for algorithm, trials in (("vio", 2), ("slam", 1)):
        for sequence in ("MH_01", "MH_05"):
            folder = tmp_path / "laptop" / algorithm / f"laptop_{algorithm}_{sequence}"
            write_run(folder / "stamped_groundtruth.txt")
            for trial in range(trials):
                suffix = trial if trials > 1 else ""
                write_run(folder / f"stamped_traj_estimate{suffix}.txt", 1.01)
    write_run(folder / "stamped_pose_graph_estimate.txt", 1.01)
    result = [run.name for run in plan(tmp_path).runs if not run.missing]
    assert result == [
        "slam traj_est MH_01", "slam traj_est MH_05", "slam pose_graph MH_05",
        "vio traj_est MH_01 0", "vio traj_est MH_01 1",
        "vio traj_est MH_05 0", "vio traj_est MH_05 1",
    ]  # fmt: skip
    missing = [run.name for run in plan(tmp_path).runs if run.missing]
    assert missing == ["slam pose_graph MH_01"]
    alone = plan(folder).runs
    assert [run.name for run in alone] == ["slam pose_graph MH_05", "slam traj_est MH_05"]


def test_an_algorithm_without_any_estimate_is_missing_everywhere(tmp_path: Path) -> None:
    ov_eval, toolbox, named = tmp_path / "ov", tmp_path / "rpg", tmp_path / "named"
    for sequence in ("A", "B"):
        write_run(ov_eval / "truths" / f"{sequence}.txt")
        write_run(ov_eval / "algorithms" / "good" / sequence / "0.txt", 1.01)
        (ov_eval / "algorithms" / "crashed" / sequence).mkdir(parents=True)
        for algorithm in ("good", "crashed"):
            folder = toolbox / "laptop" / algorithm / f"laptop_{algorithm}_{sequence}"
            write_run(folder / "stamped_groundtruth.txt")
        write_run(folder.parents[1] / "good" / f"laptop_good_{sequence}" /
                  "stamped_traj_estimate.txt", 1.01)  # fmt: skip
    for folder in (ov_eval, toolbox):
        runs = plan(folder).runs
        assert [run.sequence for run in runs if run.missing] == ["A", "B"]
        assert len({run.algorithm for run in runs}) == 2
    config = write_runs(named, trials=1)
    nowhere = "  crashed: crashed/{sequence}_trial{trial}.txt\nlengths"
    config.write_text(config.read_text().replace("lengths", nowhere))
    assert "no file matches the pattern 'crashed/" in refused(config, config.read_text())
    config.write_text(config.read_text() + "sequences: [hall, yard]\n")
    lost = [run for run in plan(config).runs if run.missing]
    assert [(run.algorithm, run.sequence) for run in lost] == [
        ("crashed", "hall"),
        ("crashed", "yard"),
    ]


def test_folders_of_sequences_by_algorithm(tmp_path: Path) -> None:
    for algorithm in ("a", "b"):
        folder = tmp_path / algorithm / "MH_01"
        write_run(folder / "stamped_groundtruth.txt")
        write_run(folder / "stamped_traj_estimate.txt", 1.01)
    names = [run.name for run in plan(tmp_path).runs]
    assert names == ["a traj_est MH_01", "b traj_est MH_01"]


def test_the_toolboxs_start_and_end_are_those_of_the_groundtruth(tmp_path: Path) -> None:
    for sequence in ("whole", "part"):
        folder = tmp_path / "laptop" / "vio" / f"laptop_vio_{sequence}"
        write_run(folder / "stamped_groundtruth.txt")
        write_run(folder / "stamped_traj_estimate.txt", 1.01)
    times = folder / "start_end_time.yaml"
    times.write_text("start_time_sec: 12.25\nend_time_sec: 20\nwhat_else: 1\n")
    runs = {run.sequence: run for run in plan(tmp_path).runs}
    assert runs["whole"].time_span is None
    assert runs["part"].time_span == TimeSpan.parse("@12.25", "@20")
    result = plan(tmp_path)
    assert result.request_of(runs["part"]).time_span == TimeSpan.parse("@12.25", "@20")
    assert result.request_of(runs["whole"]) == result.request
    message = plan_of(tmp_path, {"start": "3"})
    assert message.request_of(runs["part"]).time_span == TimeSpan.parse("3", None)
    times.write_text("end_time_sec: 15.5\n")
    (run,) = (run for run in plan(tmp_path).runs if run.sequence == "part")
    assert run.time_span == TimeSpan.parse(None, "@15.5")
    for text in ("start_time_sec: noon\n", "start_time_sec: .inf\n", "start_time_sec: [1]\n"):
        times.write_text(text)
        with pytest.raises(TrajevalError, match=r"start_end_time.yaml: start"):
            plan(tmp_path)


def test_the_toolboxs_start_and_end_are_applied(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    folder = tmp_path / "laptop" / "vio" / "laptop_vio_part"
    truth = write_run(folder / "stamped_groundtruth.txt")
    estimate = write_run(folder / "stamped_traj_estimate.txt", 1.01)
    times = "start_time_sec: 1700000005.0\nend_time_sec: 1700000012.0\n"
    (folder / "start_end_time.yaml").write_text(times)
    run_plan(plan(tmp_path), tmp_path / "out", here)
    (row,) = ResultsTable(tmp_path / "out" / RUNS).select(
        ["rmse", "count"], kind="ate", metric="position_m"
    )
    span = TimeSpan.parse("5", "12")
    assert span is not None
    sides = [read_trajectory(item) for item in (truth, estimate)]
    first = int(sides[0].stamps[0])
    ate = evaluate(*(span.cut(side, first) for side in sides)).ate["position_m"]
    assert ate is not None
    assert (row["rmse"], row["count"]) == (ate.rmse, ate.count)
    assert row["count"] == 105


def test_a_folder_of_no_convention_is_told_what_to_write(tmp_path: Path) -> None:
    with pytest.raises(TrajevalError, match=r"neither .* nor .*write a YAML configuration"):
        plan(tmp_path)
    with pytest.raises(TrajevalError, match="does not exist"):
        plan(tmp_path / "no.yaml")


@pytest.mark.parametrize(
    ("wrong", "printed"),
    [
        ("groundtruht: a", "did you mean groundtruth?"),
        ("modalty: mono", "did you mean modality?"),
        ("groundtruth: truths/{sequence}.txt", "no file matches the pattern 'truths/{sequence}"),
        ("folder: nowhere", "/nowhere does not exist"),
        ("groundtruth: groundtruth/{sequnce}.txt", "did you mean {sequence}?"),
        ("groundtruth: groundtruth/hall.txt", "no {sequence}"),
        ("groundtruth: groundtruth/{sequence}{trial}.txt", "remove {trial}"),
        ("runs: good/{sequence}.txt", "mapping of algorithms to patterns"),
        ("runs: {good: 3}", "good must be a text"),
        ("runs: {good: '{sequence}/*.txt'}", "two files are bad"),
        ("trials: 3", "trials must be a list"),
        ("sequences: [00, 01]", "0 in sequences is not text; write names such as 00 in quotes"),
        ("sequences: [hall, hall]", "lists hall twice"),
        ("trials: [null]", "None in trials is not text"),
        ('groundtruth: "x\\0/{sequence}.txt"', "not valid in a path"),
        ("common_time_span: 1", "must be true or false"),
        ("max_gap: wide", "max_gap must be a number"),
        ("modality: moon", "unknown modality 'moon'"),
        ("lengths: [4, 4]", "given twice"),
        ("runs: [", "is not valid YAML"),
        (
            "runs: {good: run/{sequence}.txt}",
            'write patterns with braces in quotes, as in {vio: "vio',
        ),
        ("- a", "is not valid YAML"),
    ],
)
def test_mistakes_are_told_in_one_sentence(tmp_path: Path, wrong: str, printed: str) -> None:
    config = write_runs(tmp_path)
    key = wrong.split(":")[0]
    lines = config.read_text().splitlines()
    if key == "runs":
        lines = lines[:1]
    kept = [line for line in lines if not line.startswith(f"{key}:")]
    message = refused(config, "\n".join([*kept, wrong]))
    assert printed in message
    assert "\n" not in message


def test_what_is_suggested_for_runs_is_yaml(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    kept = [line for line in config.read_text().splitlines() if not line.startswith(("runs", " "))]
    message = refused(config, "\n".join([*kept, "runs: vio"]))
    suggestion = message.split(", as in ")[1]
    config.write_text(f"runs: {suggestion}\n")
    assert read_mapping(config, "comparison") == {"runs": {"vio": "vio/{sequence}.txt"}}


def test_missing_keys_are_told(tmp_path: Path) -> None:
    assert "has no 'runs'" in refused(tmp_path / "x.yaml", "groundtruth: '{sequence}.txt'")
    assert "mapping" in refused(tmp_path / "x.yaml", "just a text")


def test_names_in_the_order_of_people() -> None:
    names = ["", "9", "10", "a", "t0", "t2", "t10", f"t{'9' * 5000}"]
    assert natural(reversed(names)) == names


def test_a_file_makes_this_machine_ask_no_host_that_its_user_does_not_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = pytest.importorskip("fsspec.core", reason="fsspec is missing, the extra `remote`")
    asked: list[str] = []

    def ask(url: str) -> None:
        asked.append(url)
        raise OSError("nobody is asked in tests")

    monkeypatch.setattr(core, "url_to_fs", ask)
    config = tmp_path / "runs.yaml"

    def printed(url: str, *allowed: str) -> str:
        config.write_text(f"groundtruth: '{url}'\nruns: {{vio: '{{sequence}}.txt'}}\n")
        with pytest.raises(TrajevalError) as error:
            plan_of(config, {}, allow_remote=allowed)
        return str(error.value)

    url = "https://host.net/x/{sequence}.txt"
    trust = "; if you trust the file, add --allow-remote "
    assert printed(url) == f"{config} has the remote URL {url}{trust}https://host.net"
    for other in (
        "https://host.net.evil.org/{sequence}.txt",
        "https://{sequence}.host.net/{sequence}.txt",
        "https://host.net?@evil.org/{sequence}.txt",
        "https://host.net#@evil.org/{sequence}.txt",
        "https://host.net:81/{sequence}.txt",
        "http://host.net/{sequence}.txt",
        "s3://host.net/{sequence}.txt",
        "github://me:it@main/{sequence}.txt",
    ):
        assert trust in printed(other, "https://host.net")
    chain = "zip://{sequence}.txt::https://evil.org/x.zip"
    assert "is a chain of URLs" in printed(chain, "https://host.net")
    assert "is a chain of URLs" in printed(chain.replace("zip", "file"))
    assert "has no host" in printed("https:///{sequence}.txt", "https://host.net")
    assert "has a user name or password" in printed(
        "https://host.net@evil.org/x", "https://host.net"
    )
    assert not asked
    for host in ("https://host.net", "https://host.net/", "HTTPS://host.net"):
        assert "can't be read: nobody is asked" in printed(url, "s3://bucket", host)
    assert asked == [url] * 3
    assert "can't be read" in printed("HTTPS://host.net/{sequence}.txt", "https://host.net")


@pytest.mark.parametrize("text", ["s3", "s3://", "bucket/x", "s3://bucket/x", "://x"])
def test_a_host_that_is_none_is_told(text: str, tmp_path: Path) -> None:
    with pytest.raises(
        TrajevalError, match="is not a host; write SCHEME://HOST, as in s3://bucket"
    ):
        plan_of(write_runs(tmp_path), {}, allow_remote=[text])


def test_each_file_of_runs_is_checked_and_the_command_line_names_hosts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    config = write_runs(tmp_path)
    config.write_text(config.read_text().replace("bad: ", "bad: nosuch://bucket/"))
    out = ["--output", str(tmp_path / "out")]
    assert main(["compare", "--figures", "0", str(config), *out]) == 2
    assert "add --allow-remote nosuch://bucket\n" in capsys.readouterr().err
    assert (
        main(["compare", "--figures", "0", str(config), *out, "--allow-remote", "nosuch://bucket"])
        == 2
    )
    text = capsys.readouterr().err
    assert "--allow-remote" not in text
    assert "nosuch://bucket/" in text
    assert not (tmp_path / "out").exists()


def w_first(path: Path) -> None:
    """Write a TUM file anew with the quaternion's w before x, y and z, and no header."""
    np.savetxt(path, np.loadtxt(path)[:, [0, 1, 2, 3, 7, 4, 5, 6]], fmt="%.9f")


def test_columns_of_one_algorithm_s_files(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    config = write_runs(tmp_path, trials=1)
    run_plan(plan(config), tmp_path / "out", here)
    numbers = ["algorithm", "sequence", "metric", "rmse"]
    expected = ResultsTable(tmp_path / "out" / RUNS).select(numbers)
    for path in (tmp_path / "bad").iterdir():
        w_first(path)
    with config.open("a") as file:
        file.write("columns: {bad: t x y z qw qx qy qz}\n")
    run_plan(plan(config), tmp_path / "out", here)
    assert ResultsTable(tmp_path / "out" / RUNS).select(numbers) == expected


def test_columns_of_all_algorithms_and_the_command_line_comes_first(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1)
    with config.open("a") as file:
        file.write("columns: t_s x y z qx qy qz qw\nframe_rate: 10\n")
    hints = {run.hints for run in plan(config).runs}
    assert hints == {SideHints.of("t_s x y z qx qy qz qw", 10.0)}
    text = plan_of(config, {"columns": "t x y z _ _ _ _", "frame_rate": 5.0})
    assert {run.hints for run in text.runs} == {SideHints.of("t x y z _ _ _ _", 5.0)}


def test_other_columns_are_another_run(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    config = write_runs(tmp_path, trials=1)
    first = run_plan(plan(config), tmp_path / "out", here)
    again = run_plan(plan_of(config, {"columns": "t x y z _ _ _ _"}), tmp_path / "out", here)
    assert (first.done, again.done, again.kept) == (4, 4, 0)


def test_a_folder_s_estimates_have_columns_and_a_rate_as_well(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    write_run(tmp_path / "truths" / "hall.txt")
    estimate = write_run(tmp_path / "algorithms" / "vio" / "hall" / "0.txt")
    w_first(estimate)
    out = tmp_path / "out"
    columns = ["--columns", "t x y z qw qx qy qz", "--quiet"]
    assert compare(tmp_path, *columns, output=out) == 0
    (rotated,) = ResultsTable(out / RUNS).select(["rmse"], kind="ate", metric="rotation_deg")
    assert rotated["rmse"] == pytest.approx(0.0, abs=1e-4)


def test_files_without_stamps_have_a_rate(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    for name in ("truths/hall.txt", "algorithms/vio/hall/0.txt"):
        path = write_run(tmp_path / name, count=300)
        np.savetxt(path, np.loadtxt(path)[:, 1:], fmt="%.9f")
    out = tmp_path / "out"
    assert compare(tmp_path, "--frame-rate", "2", "-q", output=out) == 0
    (row,) = ResultsTable(out / RUNS).select(["span_s"], kind="ate", metric="position_m")
    assert row["span_s"] == 149.5


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("columns: {bat: t x y z}", "columns has an unknown key 'bat'; did you mean bad?"),
        ("columns: [t, x]", "columns must be a text"),
        ("columns: t x", "columns t x have no position"),
        ("columns: {bad: ''}", "--columns is empty"),
        ("frame_rate: 0", "the frame rate must be greater than zero"),
        ("frame_rate: fast", "frame_rate must be a number"),
        ("sequnces: [hall]", "unknown key 'sequnces'; did you mean sequences?"),
        ("algorithms: {}", "unknown key 'algorithms'; use one of title, folder, manifest"),
    ],
)
def test_keys_that_mean_nothing_are_told_with_the_file(
    tmp_path: Path, line: str, told: str
) -> None:
    config = write_runs(tmp_path, trials=1)
    text = refused(config, f"{config.read_text()}{line}\n")
    assert str(config) in text
    assert told in text


@pytest.mark.parametrize("platforms", [["laptop"], ["laptop", "board"]])
def test_platforms_are_named_if_there_are_several(platforms: list[str], tmp_path: Path) -> None:
    for platform in platforms:
        folder = tmp_path / platform / "vio" / f"{platform}_vio_MH_01"
        write_run(folder / "stamped_groundtruth.txt")
        write_run(folder / "stamped_traj_estimate.txt", 1.01)
    names = {run.algorithm for run in plan(tmp_path).runs}
    several = {f"{platform} vio traj_est" for platform in platforms}
    assert names == (several if len(platforms) > 1 else {"vio traj_est"})
