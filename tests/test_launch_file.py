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
        "launch.substitutions": {
            "LaunchConfiguration": LaunchConfiguration,
            "PathJoinSubstitution": list,
        },
        "launch_ros": {},
        "launch_ros.actions": {"Node": keep},
        "launch_ros.substitutions": {"FindPackageShare": str},
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
def test_simulated_time_is_the_file_s_unless_it_is_given() -> None:
    file = LaunchConfiguration("params_file")
    assert launched()["parameters"] == [file]
    for given in ("true", "false"):
        over = {"use_sim_time": LaunchConfiguration("use_sim_time")}
        assert launched(use_sim_time=given)["parameters"] == [file, over]
