"""What the figures of all commands show: each line, colour, label and limit, as it was kept."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from kept import assert_kept, described
from kept_runs import printed

from trajeval_ros.report import figure_output, figures

pytest.importorskip("matplotlib", reason="figures need the extra `plot`")

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SLOW = pytest.mark.slow
FLIGHT = "evaluate -g run:/groundtruth/pose -e run:/vio/odometry --output out"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "shown", "typed"),
    [
        ("one", "", "evaluate truth.txt a.txt --output out"),
        ("two", "rel", "evaluate truth.txt a.txt b.txt --lengths 4,8% --output out"),
        pytest.param("four", "top|abs", "evaluate truth.txt a.txt b.txt c.txt d.txt "
            "--output out", marks=SLOW),
        ("fixes", "", "evaluate -g drive:/fix -e drive:/vio/odometry --output out"),
        pytest.param("consistency", "cons|unc|stan", "evaluate vi:/groundtruth/pose "
            "vi:/vio/odometry --covariance message --alert-limit 0.5,5 --risk 0.05 --output out",
            marks=SLOW),
        ("available", "as_", f"{FLIGHT} --as-available twist"),
        ("by_error", "", "trajectory a.txt b.txt --reference truth.txt --gauge yaw "
         "--plot xy,3d,xyz,rpy,speed --colour-by error --output out"),
        ("by_speed", "", "trajectory a.txt --plot xz --colour-by speed --output out"),
        ("watch", "", "watch run:/vio/odometry --imu run:/imu --figure out.png"),
        pytest.param("likelihood", "mah|lik|prob|cont|rel", f"{FLIGHT} --association continuous "
            "--groundtruth-noise 0.01,0.2", marks=SLOW),
        pytest.param("groundtruth", "", "groundtruth run:/groundtruth/pose --imu run:/imu "
            "--figure out.png", marks=SLOW),
    ],
)  # fmt: skip
def test_figures_show_what_they_showed(
    name: str,
    shown: str,
    typed: str,
    kept_runs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    drawn = []

    def save(figure: Figure, path: Path, file_format: str) -> Path:
        if re.search(shown, path.stem):
            drawn.append(f"{path.stem}\n{described(figure)}")
        path.write_text(file_format)
        return path

    monkeypatch.setattr(figure_output, "save", save)
    monkeypatch.setattr(figures, "save", save)
    assert "status 0" in printed(typed, kept_runs, tmp_path, capsys)
    assert_kept(f"figures_{name}", "\n".join(drawn))
