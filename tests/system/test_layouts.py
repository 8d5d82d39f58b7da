"""The layouts of Foxglove, PlotJuggler and RViz: what they draw is in a recording of errors."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from paths import ROOT
from recorded_errors import Recorded, read_recording

from trajeval_ros.cli.app import main
from trajeval_ros.io.yaml_file import read_mapping

FOXGLOVE, PLOTJUGGLER = ROOT / "config" / "foxglove.json", ROOT / "config" / "plotjuggler.xml"
RVIZ = ROOT / "config" / "evaluator.rviz"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recorded]:
    folder = tmp_path_factory.mktemp("layouts")
    bag, errors = folder / "flight", folder / "errors.mcap"
    assert main(["simulate", str(bag), "--duration", "20"]) == 0
    sources = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry"]
    assert main(["evaluate", *sources, "--mcap", str(errors), "--quiet"]) == 0
    return read_recording(errors)


@pytest.fixture(scope="module")
def panels() -> dict[str, Any]:
    result: dict[str, Any] = json.loads(FOXGLOVE.read_text())["configById"]
    return result


def number_at(message: Any, fields: list[str]) -> float:
    for field in fields:
        message = getattr(message, field)
    assert isinstance(message, float)
    return message


def foxglove_paths(panels: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for config in panels.values():
        yield from config.get("paths", ())


def test_foxglove_plots_what_is_there(
    recorded: dict[str, Recorded], panels: dict[str, Any]
) -> None:
    drawn = list(foxglove_paths(panels))
    assert len(drawn) == 10
    for item in drawn:
        topic, *fields = item["value"].split(".")
        message = recorded[topic].messages[0]
        number_at(message, fields)
        # The time axis is that of the stamps where there are any.
        assert (item["timestampMethod"] == "headerStamp") == hasattr(message, "header")


def test_foxglove_s_other_panels_show_what_is_there(
    recorded: dict[str, Recorded], panels: dict[str, Any]
) -> None:
    for topic in panels["3D!paths"]["topics"]:
        assert recorded[topic].type == "nav_msgs/msg/Path"
    status = panels["DiagnosticStatusPanel!status"]
    [message] = recorded[status["topicToRender"]].messages
    [shown] = [item for item in message.status if item.name == status["selectedName"]]
    assert shown.hardware_id == status["selectedHardwareId"]


def test_every_panel_of_foxglove_has_its_place_once(panels: dict[str, Any]) -> None:
    def leaves(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            yield from leaves(node["first"])
            yield from leaves(node["second"])

    layout = json.loads(FOXGLOVE.read_text())["layout"]
    assert sorted(leaves(layout)) == sorted(panels)


def test_plotjuggler_plots_what_is_there(recorded: dict[str, Recorded]) -> None:
    curves = [item.attrib["name"] for item in ElementTree.parse(PLOTJUGGLER).iter("curve")]
    assert len(curves) == 10
    for curve in curves:
        [topic] = [item for item in recorded if curve.startswith(f"{item}/")]
        fields = curve.removeprefix(f"{topic}/").split("/")
        number_at(recorded[topic].messages[0], fields)


def test_splitters_of_plotjuggler_count_their_parts() -> None:
    splitters = list(ElementTree.parse(PLOTJUGGLER).iter("DockSplitter"))
    assert splitters
    for splitter in splitters:
        assert (
            int(splitter.attrib["count"])
            == len(splitter)
            == len(splitter.attrib["sizes"].split(";"))
        )


def test_rviz_shows_paths_that_are_there_in_their_frame(recorded: dict[str, Recorded]) -> None:
    manager = read_mapping(RVIZ, "layout")["Visualization Manager"]
    frame = manager["Global Options"]["Fixed Frame"]
    paths = [
        display
        for display in manager["Displays"]
        if display["Class"] == "rviz_default_plugins/Path"
    ]
    topics = [path["Topic"]["Value"] for path in paths]
    # Estimates that revise their past are seen live alone.
    assert topics.pop() == "/evaluator/vio_odometry/revised/aligned_path"
    assert len(topics) == 2
    for topic in topics:
        assert recorded[topic].type == "nav_msgs/msg/Path"
        assert {message.header.frame_id for message in recorded[topic].messages} == {frame}


@pytest.mark.parametrize("layout", [FOXGLOVE, PLOTJUGGLER, RVIZ], ids=lambda path: path.name)
def test_layouts_are_installed(layout: Path) -> None:
    assert f'"config/{layout.name}"' in (ROOT / "setup.py").read_text()
    assert f"config/*{layout.suffix}" in (ROOT / "MANIFEST.in").read_text()
