"""An option that has no effect is an error or a warning, never ignored."""

from __future__ import annotations

from pathlib import Path

import pytest

from trajeval_ros.cli.app import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unused")
    bag = folder / "flight"
    assert main(["simulate", str(bag), "--duration", "12"]) == 0
    both = [f"{bag}:/groundtruth/pose", f"{bag}:/vio/odometry"]
    saved = ["--quiet", "--output", str(folder), "--save-as", "tum"]
    assert main(["trajectory", *both, *saved]) == 0
    rows = (folder / "vio_odometry.txt").read_text().splitlines()[1:]
    (folder / "places.txt").write_text("\n".join(" ".join(row.split()[:4]) for row in rows) + "\n")
    matrix = "1 0 0 {:.3f} 0 1 0 {:.3f} 0 0 1 0"
    frames = [matrix.format(0.1 * i, 0.002 * i * i) for i in range(100)]
    (folder / "frames.txt").write_text("\n".join(frames) + "\n")
    frames = [matrix.format(0.1 * i, 0.0021 * i * i) for i in range(100)]
    (folder / "other.txt").write_text("\n".join(frames) + "\n")
    return folder


TUM = ["{}/groundtruth_pose.txt", "{}/vio_odometry.txt"]
BAG = ["{}/flight:/groundtruth/pose", "{}/flight:/vio/odometry"]
ROWS = ["{}/frames.txt", "{}/other.txt"]
PLACES = ["{}/groundtruth_pose.txt", "{}/places.txt"]
ONE = ["{}/vio_odometry.txt"]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["evaluate", *TUM, "--frame-rate", "10"], "--frame-rate is for text files without"),
        (["evaluate", *BAG, "--frame-rate", "10"], "--frame-rate is for text files without"),
        (["evaluate", *BAG, "--columns", "t x y z"], "--columns is for text files"),
        (["evaluate", *TUM, "--gauge", "none", "--align-states", "5"], "need an alignment"),
        (["evaluate", *TUM, "--gauge", "none", "--align-states", "1,50%"], "need an alignment"),
        (["evaluate", *BAG, "--gauge", "none", "--align-weights", "covariance"], "alignment"),
        (["info", *ONE, "--frame-rate", "10"], "--frame-rate is for text files without"),
        (["info", "{}/flight", "--frame-rate", "10"], "--frame-rate is for text files without"),
        (["info", "{}/flight:/vio/odometry", "--columns", "t x y z"], "--columns is for text"),
        (["trajectory", *ONE, "--frame-rate", "10"], "--frame-rate is for text files without"),
        (["trajectory", ROWS[0], "--clock-rate", "9"], "no timestamps, which a clock rate needs"),
        (
            ["trajectory", PLACES[1], "--quaternion-order", "wxyz"],
            "no orientations, which a quaternion order needs",
        ),
        (["evaluate", *TUM, "-as"], "no option -a; use --gauge se3, or --gauge sim3 for"),
        (["evaluate", *TUM, "-s"], "no option -s; use --gauge sim3 for evo's -as; for -s alone"),
        (["evaluate", *TUM, "-d", "8", "-u", "m"], "no option -d; use --lengths"),
        (["evaluate", *TUM, "--align_origin"], "no option --align_origin; use --align-states 1"),
        (["evaluate", *TUM, "--common-time-span"], "use trajeval compare --common-time-span"),
        (["trajectory", *ONE, "--plot_mode", "xz"], "use --plot xy, xz, yz or 3d"),
        (["compare", "x.csv", "--require", "x<1"], "use trajeval evaluate --require for a run"),
        (["finish", "{}", "--modality", "mono"], "the alignment is that of the live run"),
        (["tum", *TUM, "-as"], "no verb tum; formats are detected by content"),
        (["evaluate", *TUM, "-va"], "no option -v; all details are printed; remove it"),
        (["evo_ape", "tum", *TUM], "no verb evo_ape; use trajeval evaluate, with --protocol evo"),
        (["ape", "tum", *TUM], "no verb ape; use trajeval evaluate, with --protocol evo"),
        (["res", "a.zip"], "no verb res; use trajeval compare RESULT..."),
        (["evaluate", *TUM, "-p"], "no option -p; --output DIR draws figures"),
        (["evaluate", *TUM, "--plot"], "no option --plot; --output DIR draws figures"),
        (["evaluate", *TUM, "--align"], "no option --align; use --gauge se3"),
        (["evaluate", *TUM, "--save_results", "x.zip"], "no option --save_results; use --output"),
        (["evaluate", "tum", *TUM], "tum is a format, which is detected"),
        (["evaluate", "-g", TUM[0], "-g", TUM[1], "-e", TUM[1]], "is given 2 times"),
        (["evaluate", *TUM, *["--correct", "unit"] * 2], "--correct is given 2 times; give one"),
        (["trajectory", *ONE, *["--reference", TUM[0]] * 3, "--gauge", "yaw"], "given 3 times"),
        (["trajectory", *ONE, "--merge"], "--merge needs several sources"),
        (["trajectory", *ONE, "--output", "{}/new"], "--output needs --save-as or --plot"),
        (["trajectory", *ONE, "--reference", TUM[0]], "--reference needs an operation"),
        (["trajectory", *ONE, "--plot", "xyz", "--colour-by", "speed"], "--colour-by needs"),
        (["compare", "x.csv", "--undecided", "fail"], "need --baseline and --fail-if"),
        (["compare", "x.csv", "--false-alarms", "5"], "need --baseline and --fail-if"),
        (
            ["study", "association", "-g", TUM[0], "-e", TUM[1], "--dropouts", "0",
             "--dropout-length", "2,3"],
            "--dropout-length needs dropouts",
        ),
        (
            ["study", "gauge", "--output", "{}/study", "--start", "1", "--duration", "9"],
            "--start, --duration: no effect without --motion; add it",
        ),
        (["study", "gauge", "--output", "{}/study", "--keyframes", "9"], "--motion or --tracks"),
        (["study", "gauge", "--output", "{}/study", "--gravity", "9.8"], "without --tracks"),
    ],
    ids=lambda item: " ".join(item).replace("{}/", "") if isinstance(item, list) else "",
)  # fmt: skip
def test_an_option_without_an_effect_is_refused(
    folder: Path, command: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if command[0] == "compare":
        pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    before = sorted(folder.rglob("*"))
    # plan_of is called before the baseline is checked.
    (folder / "x.csv").write_text("algorithm,sequence,groundtruth,estimate\na,b,c,d\n")
    words = [str(folder / item) if item == "x.csv" else item.format(folder) for item in command]
    assert main(words) == 2
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert message in line
    assert shown.out == ""
    (folder / "x.csv").unlink()
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            ["evaluate", *TUM, "--datum", "47,8,400"],
            "no effect of --datum: the groundtruth",
        ),
        (
            ["evaluate", *TUM, "--min-fix-status", "2", "--max-fix-sigma", "1"],
            "no effect of --min-fix-status, --max-fix-sigma: the groundtruth",
        ),
        (["evaluate", *TUM, "--fix-correlation", "5"], "no effect of --fix-correlation: the"),
        (
            ["evaluate", *ROWS, "--association", "nearest", "--max-time-difference", "1"],
            "no effect of --association, --max-time-difference: without timestamps",
        ),
        (["evaluate", *ROWS, "--max-gap", "3"], "no effect of --max-gap: without timestamps"),
        (["evaluate", *ROWS, "--time-offset", "3"], "no effect of --time-offset: without"),
    ],
)
def test_settings_that_these_data_do_not_need_are_named_in_a_warning(
    folder: Path, command: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([item.format(folder) for item in command]) == 0
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ["evaluate", *ROWS],
        ["evaluate", *ROWS, "--protocol", "evo"],
        ["evaluate", *ROWS, "--protocol", "kitti"],
        ["evaluate", *TUM],
        ["evaluate", *TUM, "--gauge", "none", "--align-states", "all"],
        ["evaluate", *BAG, "--strict"],
        ["evaluate", TUM[0], BAG[1], "--strict"],
        ["evaluate", *TUM, "--strict"],
        ["evaluate", *ROWS, "--frame-rate", "10", "--max-gap", "3"],
        ["trajectory", *ONE, "--reference", TUM[0], "--start", "1"],
        ["trajectory", *TUM, "--merge"],
        ["info", ROWS[0], "--frame-rate", "10"],
    ],
    ids=lambda item: " ".join(item).replace("{}/", ""),
)
def test_options_with_an_effect_are_taken(
    folder: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([item.format(folder) for item in command]) == 0
    assert "no effect" not in capsys.readouterr().err
