"""What the launch file hands to the node, with stand-ins for ROS's launch packages.

These are in no environment that tests run in.
"""

from __future__ import annotations

import runpy
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from trajeval_ros.ros.parameter_table import PARAMETERS

FILE = Path(__file__).resolve().parent.parent / "launch" / "evaluator.launch.py"


@dataclass(frozen=True)
class LaunchConfiguration:
    """The value of an argument, known when its context is."""

    name: str

    def perform(self, context: dict[str, str]) -> str:
        return context[self.name]


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    def keep(*_: Any, **words: Any) -> dict[str, Any]:
        return words

    def declare(name: str, **words: Any) -> dict[str, Any]:
        return {"argument": name, **words}

    modules: dict[str, dict[str, Any]] = {
        "launch": {"LaunchContext": dict, "LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": declare, "OpaqueFunction": keep},
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": keep},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)


def launched(**given: str) -> Any:
    """Return the node as it is launched with arguments."""
    entities = runpy.run_path(str(FILE))["generate_launch_description"]()
    context = {each["argument"]: each["default_value"] for each in entities if "argument" in each}
    [action] = [each for each in entities if "argument" not in each]
    [node] = action["function"]({**context, **given})
    return node


@pytest.mark.usefixtures("stand_ins")
def test_two_topics_are_enough() -> None:
    node = launched(groundtruth_topic="/mocap/pose", estimate_topics="/vio/odometry, /slam/path")
    assert node["parameters"] == [
        {"groundtruth_topic": "/mocap/pose", "estimate_topics": ["/vio/odometry", "/slam/path"]}
    ]
    assert node["name"] == LaunchConfiguration("name")
    assert node["namespace"] == LaunchConfiguration("namespace")
    [alone] = launched(estimate_topics="['/vio/odometry']")["parameters"]
    assert alone == {"estimate_topics": ["/vio/odometry"]}


@pytest.mark.usefixtures("stand_ins")
def test_what_is_given_stands_over_the_file_and_nothing_else_does() -> None:
    assert launched()["parameters"] == []
    assert launched(params_file="judge.yaml")["parameters"] == ["judge.yaml"]
    for given, value in (("true", True), ("false", False)):
        found = launched(params_file="judge.yaml", use_sim_time=given)["parameters"]
        assert found == ["judge.yaml", {"use_sim_time": value}]


@pytest.mark.usefixtures("stand_ins")
def test_status_lines_come_through_a_pipe() -> None:
    assert "emulate_tty" not in launched()


@pytest.mark.usefixtures("stand_ins")
def test_arguments_are_parameters_of_the_node() -> None:
    names = {each.name for each in PARAMETERS} | {"use_sim_time"}
    assert runpy.run_path(str(FILE))["PARAMETERS"].keys() <= names
