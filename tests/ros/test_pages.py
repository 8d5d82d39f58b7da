"""The tutorial on a live run, typed: the node in one terminal, the rest in another."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import pytest
from page_commands import ROOT, commands, environment_with_programs, typed
from waiting import PATIENCE_S

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

PAGE = ROOT / "docs/tutorials/live_run.md"


def test_the_tutorial_runs_as_it_stands(environment: dict[str, str], tmp_path: Path) -> None:
    result = environment_with_programs(tmp_path / "bin", **environment)
    node, *others = commands(PAGE.read_text(encoding="utf-8"))
    finish = others.pop()
    assert node.startswith("ros2 run trajeval_ros evaluator")
    assert finish.startswith("trajeval finish")

    with subprocess.Popen(["bash", "-c", node], cwd=tmp_path, env=result) as process:
        try:
            for command in others:
                if not command.startswith("ros2 topic"):  # of ros2cli, which has no wheel
                    typed(command, tmp_path, result)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    (run,) = json.loads((tmp_path / "live/result.json").read_text())["runs"]
    assert run["association"]["pairs"] > 100
    typed(finish, tmp_path, result)
