"""The table of settings: everything that states a setting is derived from its row."""

from __future__ import annotations

import dataclasses
import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT

from trajeval_ros.batch.plan import Plan
from trajeval_ros.cli.app import VERBS, verb
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.requests.request_from import (
    in_names_of_settings,
    protocol_from,
    read_protocol,
    request_from,
)
from trajeval_ros.io.requests.setting import NODE, Setting
from trajeval_ros.io.requests.settings_table import (
    SETTINGS,
    settings_of,
    settings_of_many_runs,
)
from trajeval_ros.metrics.association_rule import METHODS
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.request import Request
from trajeval_ros.ros.parameter_table import PARAMETERS

# Fields that no user sets: the pipeline and the comparison do.
INTERNAL = {"span_ns", "lengths_of_groundtruth", "gauge_is_default", "covariances.marker_lever_m",
            "discontinuities.correct_clock_steps"}  # fmt: skip
# Fields of parts that are None by default.
OPTIONAL = {
    "time_span": ("start_ns", "end_ns", "absolute_start", "absolute_end"),
    "integrity": ("alert_limit_m", "alert_limit_deg", "risk"),
}
WHOLE = {"protocol.score", "protocol.recall", "corrections", "protocol.association.noise"}


def fields(whole: Any, path: str = "") -> Iterator[str]:
    """Yield the paths of all fields of a request that are no dataclasses themselves."""
    for field in dataclasses.fields(whole):
        value, name = getattr(whole, field.name), f"{path}{field.name}"
        if name in OPTIONAL:
            yield from (f"{name}.{item}" for item in OPTIONAL[name])
        elif dataclasses.is_dataclass(value) and name not in WHOLE:
            yield from fields(value, f"{name}.")
        else:
            yield name


def test_every_field_of_a_request_is_the_target_of_a_row() -> None:
    targets = [target for setting in SETTINGS.values() for target in setting.targets]
    assert {*targets, *INTERNAL} == set(fields(Request()))
    assert len(targets) == len(set(targets))


def test_the_help_of_the_association_names_every_method() -> None:
    assert not [method for method in METHODS if method not in SETTINGS["association"].help]


def test_settings_of_a_request_are_json_and_complete() -> None:
    stated = settings_of(
        request_from(
            {
                "modality": "mono",
                "align_states": "1,50%,all",
                "time_offset": "auto",
                "lengths": "8,1s",
                "covariance": "message",
                "groundtruth_noise": "0.002,0.1",
                "alert_limit": "0.5,2",
                "start": "1.5",
                "end": "+3",
                "datum": "47,8,400",
                "up": "-y,z",
            }
        )
    )
    assert stated.keys() == SETTINGS.keys()
    assert json.loads(json.dumps(stated)) == stated
    expected = {
        "protocol": "default",
        "modality": "mono",
        "gauge": "sim3",
        "align_states": "1,50%,all",
        "time_offset": "auto",
        "lengths": ["8m", "1s"],
        "groundtruth_noise": [0.002, 0.1],
        "alert_limit": [0.5, 2.0],
        "risk": 1e-5,
        "start": "1.500000000",
        "end": "4.500000000",
        "datum": [47.0, 8.0, 400.0],
        "up": ["-y", "z"],
    }
    assert {name: stated[name] for name in expected} == expected


@pytest.mark.parametrize("name", SETTINGS)
def test_a_default_that_is_stated_again_changes_nothing(name: str) -> None:
    setting = SETTINGS[name]
    default = setting.default
    if default is None or name == "gauge":  # a gauge that is stated is not the default one
        return
    given = {"protocol": default} if name == "protocol" else {name: setting.of_yaml(default)}
    if name in ("max_time_difference",):
        given["association"] = "nearest"
    if name == "continuous_model":
        given["association"] = "continuous"
    if name == "risk":
        given |= {"alert_limit": "1", "covariance": "message"}
    other = {item: value for item, value in given.items() if item != name}
    assert settings_of(request_from(given)) == settings_of(request_from(other))


def test_the_provenance_of_a_comparison_has_all_settings() -> None:
    settings = Plan("title", (), Request()).settings
    assert settings.keys() == {*SETTINGS, "common_time_span"}


def test_options_keys_and_parameters_are_those_of_the_rows() -> None:
    for name in VERBS:
        options = {parameter.name for parameter in verb(name).params}
        stated = {setting.name for setting in SETTINGS.values() if name in setting.verbs}
        if name != NODE:
            assert stated <= options
    assert {setting.name for setting in SETTINGS.values() if NODE in setting.verbs} <= {
        parameter.name for parameter in PARAMETERS
    }
    assert len(PARAMETERS) <= 53  # 50, as_available, limits_age_s and rerun_points
    assert not settings_of_many_runs().keys() & {"correct", "watch_factor", "corrections"}


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("lengths", [8, "1s"], "8,1s"),
        ("lengths", [], "none"),
        ("lengths", 8, "8"),
        ("gauge", None, "none"),
        ("max_gap", 1, 1.0),
        ("align_states", 5, "5"),
        ("min_fix_status", 2, 2),
        ("in_order", True, True),
    ],
)
def test_values_of_yaml_are_those_of_the_command_line(
    name: str, value: Any, expected: Any
) -> None:
    result = SETTINGS[name].of_yaml(value)
    assert (result, type(result)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("max_gap", "soon", "max_gap must be a number, not 'soon'"),
        ("max_gap", True, "max_gap must be a number, not True"),
        ("gauge", {"a": 1}, "gauge must be a text"),
        ("in_order", "yes", "in_order must be true or false"),
        ("min_fix_status", 1.5, "min_fix_status must be a whole number"),
        ("score", 3, "score must be a mapping"),
    ],
)
def test_values_of_another_type_are_refused(name: str, value: Any, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        SETTINGS[name].of_yaml(value)


def test_a_protocol_file_takes_all_settings_of_a_protocol(tmp_path: Path) -> None:
    file = tmp_path / "ours.yaml"
    file.write_text("base: hilti-2022\nlever_arm: null\nscore: null\ntime_offset: 0.5\n")
    read = read_protocol(file)
    assert (read.lever_m, read.score, read.association.time_offset_s) == (None, None, 0.5)
    file.write_text("continuous_model: wnoa\n")
    with pytest.raises(InputError, match="continuous_model needs association: continuous"):
        read_protocol(file)
    assert protocol_from(Protocol(), gauge=None) == Protocol()


def test_messages_name_what_their_reader_wrote() -> None:
    text = "--lever-arm needs --hand-eye auto, or --help-all"
    assert in_names_of_settings(text) == "lever_arm needs hand_eye: auto, or --help-all"
    assert in_names_of_settings(text, ":=") == "lever_arm needs hand_eye:=auto, or --help-all"


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the module that writes the page and the file."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    yield importlib.import_module("settings_tables")
    sys.modules.pop("settings_tables", None)


def test_the_page_and_the_parameter_file_are_up_to_date(tables: Any) -> None:
    page = tables.PAGE.read_text(encoding="utf-8")
    assert tables.page_with(tables.settings_table(), page) == page, "run make settings"
    formats = tables.FORMATS.read_text(encoding="utf-8")
    assert tables.page_with(tables.layouts_table(), formats) == formats, "run make settings"
    assert tables.PARAMETER_FILE.read_text(encoding="utf-8") == tables.parameter_file()


NEW_ROW = """
import sys, tempfile
from pathlib import Path
from trajeval_ros.io.requests.setting import Setting
from trajeval_ros.io.requests.settings_table import SETTINGS, settings_of
SETTINGS["patience"] = Setting(
    name="patience", help="Something new, in seconds. Default: {default}.", kind=float,
    target="protocol.association.max_gap_s", metavar="S", panel="Errors",
    verbs=("evaluate", "compare", "finish", "evaluator"), range=(0.0, 9.0), is_live=True,
)
from trajeval_ros.batch.config import plan_of
from trajeval_ros.cli.app import main
from trajeval_ros.cli.app import verb
from trajeval_ros.io.requests.request_from import read_protocol, request_from
for name in ("evaluate", "compare", "finish"):
    (option,) = [each for each in verb(name).params if each.name == "patience"]
    assert option.opts == ["--patience"] and option.help.endswith("Default: 0.5."), option.help
assert request_from({"patience": 0.25}).protocol.association.max_gap_s == 0.25
folder = Path(tempfile.mkdtemp())
(folder / "ours.yaml").write_text("patience: 0.125\\n")
assert read_protocol(folder / "ours.yaml").association.max_gap_s == 0.125
(folder / "runs.csv").write_text("algorithm,sequence,groundtruth,estimate\\na,b,c,d\\n")
(folder / "all.yaml").write_text("manifest: runs.csv\\npatience: 0.125\\n")
plan = plan_of(folder / "all.yaml", {})
assert plan.request.protocol.association.max_gap_s == 0.125
assert plan.settings["patience"] == 0.125
assert settings_of(plan.request)["patience"] == 0.125
from trajeval_ros.ros.parameter_table import PARAMETERS
(parameter,) = [each for each in PARAMETERS if each.name == "patience"]
assert (parameter.default, parameter.range, parameter.is_live) == (0.5, (0.0, 9.0), True)
from trajeval_ros.ros.parameters import request_of
values = {each.name: each.default for each in PARAMETERS} | {"patience": 0.25}
del SETTINGS["max_gap"]  # both have one target
assert request_of(values).protocol.association.max_gap_s == 0.25
sys.path.insert(0, "docs/site")
import settings_tables
assert "| `patience` | `0.5` |" in settings_tables.settings_table()
assert "    patience: 0.5\\n" in settings_tables.parameter_file()
"""


@pytest.mark.slow
def test_a_new_setting_is_one_row() -> None:
    done = subprocess.run(
        [sys.executable, "-c", NEW_ROW], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_rows_are_sound() -> None:
    assert SETTINGS
    for name, setting in SETTINGS.items():
        assert isinstance(setting, Setting)
        assert setting.name == name
        assert setting.targets
        if setting.choices and isinstance(setting.default, str):
            assert setting.default in setting.choices
        assert not setting.is_live or NODE in setting.verbs
