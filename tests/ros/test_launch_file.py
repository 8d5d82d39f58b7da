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
from paths import ROOT

from trajeval_ros.ros.parameter_table import PARAMETERS

FILE = ROOT / "launch" / "evaluator.launch.py"


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
        "launch.actions": {
            "DeclareLaunchArgument": declare,
            "IncludeLaunchDescription": lambda source, **words: {"source": source, **words},
            "OpaqueFunction": keep,
        },
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": "".join},
        "launch.substitutions": {
            "LaunchConfiguration": LaunchConfiguration,
            "ThisLaunchFileDir": lambda: str(FILE.parent),
        },
        "launch_ros": {},
        "launch_ros.actions": {"Node": keep},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)


def launched(file: Path = FILE, **given: str) -> Any:
    """Return the node, or what a file launches, with arguments."""
    entities = runpy.run_path(str(file))["generate_launch_description"]()
    context = {
        entity["argument"]: entity["default_value"] for entity in entities if "argument" in entity
    }
    [action] = [entity for entity in entities if "argument" not in entity]
    result = action["function"]({**context, **given})
    return result[0] if file == FILE else result


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
        result = launched(params_file="judge.yaml", use_sim_time=given)["parameters"]
        assert result == ["judge.yaml", {"use_sim_time": value}]


@pytest.mark.usefixtures("stand_ins")
def test_status_lines_come_through_a_pipe() -> None:
    assert "emulate_tty" not in launched()


@pytest.mark.usefixtures("stand_ins")
def test_arguments_are_parameters_of_the_node() -> None:
    names = {parameter.name for parameter in PARAMETERS} | {"use_sim_time"}
    assert runpy.run_path(str(FILE))["PARAMETERS"].keys() <= names


@pytest.mark.usefixtures("stand_ins")
def test_each_of_three_robots_has_an_evaluator_in_its_namespace() -> None:
    included = launched(FILE.with_name("three_robots.launch.py"), modality="stereo-inertial")
    arguments = [dict(item["launch_arguments"]) for item in included]
    assert {item["source"] for item in included} == {str(FILE)}
    assert [argument["namespace"] for argument in arguments] == ["robot1", "robot2", "robot3"]
    assert [argument["output"] for argument in arguments] == [
        f"trajeval/robot{n}" for n in (1, 2, 3)
    ]
    declared = runpy.run_path(str(FILE))["generate_launch_description"]()
    names = {item["argument"] for item in declared if "argument" in item}
    assert set(arguments[0]) <= names
