"""Mistakes that users made with their first files, and the sentences that answer them."""

from __future__ import annotations

from pathlib import Path

import pytest
from comparison_runs import write_run

from trajeval_ros.cli.app import main


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with trajectories, a picture and a YAML file."""
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "gt.txt")
    rows = write_run(tmp_path / "vio.txt", 1.01).read_text().splitlines()
    later = [f"{float(row.split()[0]) + 9_758_120.0:.6f} {row.split(' ', 1)[1]}" for row in rows]
    (tmp_path / "later.txt").write_text("\n".join(later))
    (tmp_path / "picture.txt").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (tmp_path / "flow.yaml").write_text(
        "groundtruth: g/{sequence}.txt\nruns: {a: {sequence}.txt}\n"
    )
    return tmp_path


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("evaluate -g gt.txt -g vio.txt -e vio.txt", "--groundtruth is given 2 times"),
        ("evaluate gt.txt picture.txt", "is a picture (PNG)"),
        ("evaluate gt.txt later.txt", "113 days apart; the estimate is probably of another"),
        ("compare flow.yaml", "write patterns with braces in quotes"),
        ("compare gt.txt", "gt.txt is not a comparison; give a YAML file (.yaml), a manifest"),
        ("compare gone.txt vio.txt", "gone.txt does not exist"),
        ("compare gt.txt Ours=gone.txt more.txt", "gone.txt does not exist"),
    ],
)
def test_a_mistake_is_answered_with_its_cause(
    typed: str, answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if typed.startswith("compare"):
        pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    assert main(typed.split()) == 2
    assert answer in capsys.readouterr().err
    assert not Path("comparison").exists()


def test_names_of_trajectories_are_those_of_estimates(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["Team=gt.txt", "later.txt", "--merge", "--save-as", "tum", "--output", "out"]
    assert main(["trajectory", *given]) == 0
    assert "Team: merged from Team, later" in capsys.readouterr().err
    assert [path.name for path in (files / "out").iterdir()] == ["Team.txt"]


def test_merged_trajectories_state_what_was_dropped(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["gt.txt", "vio.txt", "--merge", "--save-as", "tum", "--output", "out"]
    assert main(["trajectory", *given]) == 0
    assert "300" in capsys.readouterr().err
    assert len(list((files / "out").glob("*.txt"))) == 1
