"""The plan of a comparison: from a YAML file, a manifest, or a folder of a known layout."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.batch.folder_layouts import runs_in_folder
from trajeval_ros.batch.manifest import is_manifest, runs_in_manifest
from trajeval_ros.batch.patterns import Pattern, is_url
from trajeval_ros.batch.plan import Name, Plan, PlannedRun, all_runs
from trajeval_ros.batch.remote_files import host_of, parse_hosts, require_allowed
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.checks import require_known
from trajeval_ros.io.requests.request_from import (
    in_names_of_settings,
    is_protocol_file,
    request_from,
)
from trajeval_ros.io.requests.setting import AUTO, MESSAGE, NONE
from trajeval_ros.io.requests.settings_table import settings_of_many_runs
from trajeval_ros.io.source_names import is_source, names_of, names_with, split_name
from trajeval_ros.io.sources import parse_source, require_no_password
from trajeval_ros.io.text.hints import GROUNDTRUTH, SideHints
from trajeval_ros.io.yaml_file import read_mapping
from trajeval_ros.pipeline.request import Request

_KEYS = (
    "title", "folder", "manifest", "groundtruth", "runs", "sequences", "trials",
)  # fmt: skip
_OF_COMPARISONS = ("common_time_span", "columns", "frame_rate")  # settings of no request


def plan_of(
    target: str | Path, settings: Mapping[str, Any], *, allow_remote: Iterable[str] = ()
) -> Plan:
    """Return the plan of a comparison.

    `target`: a YAML file, a manifest (its path or URL), or a folder of a known layout. `settings`:
    of the request and `common_time_span`, `columns`, `frame_rate`, as on the command line; they
    override the file. `allow_remote`: hosts that URLs in the file may name, `SCHEME://HOST`. The
    host of a manifest's own URL is allowed.
    """
    require_no_password(str(target))
    hosts = parse_hosts(allow_remote)
    path = Path(target)
    if path.is_dir() or is_manifest(str(target)):
        if path.is_dir():
            title, runs = path.resolve().name, runs_in_folder(path)
        else:
            title, runs = path.stem, runs_in_manifest(str(target), hosts | host_of(str(target)))
        return _plan(title, runs, settings)
    if is_url(str(target)):
        raise InputError(
            f"{target} is not a manifest (.csv or .parquet); copy the file to this machine"
        )
    return _plan_of_yaml(path, settings, hosts)


def plan_of_sources(sources: Sequence[str], settings: Mapping[str, Any]) -> Plan:
    """Return the plan of a comparison of estimates of one groundtruth.

    `sources`: the groundtruth, and estimates as SOURCE or NAME=SOURCE, of which one must exist.
    """
    groundtruth, *estimates = sources
    named = [split_name(estimate) for estimate in estimates]
    paths = [source for _, source in named]
    for item in (groundtruth, *paths):  # names are made from them
        require_no_password(item)
    parse_source(groundtruth)
    if not any(map(is_source, paths)):
        parse_source(paths[0])
    _, *names = names_with(["", *(name for name, _ in named)], [groundtruth, *paths])
    sequence = names_of([groundtruth])[0]
    runs = [
        PlannedRun(name, sequence, "", groundtruth=groundtruth, estimate=path)
        for name, path in zip(names, paths, strict=True)
    ]
    return _plan(sequence, runs, settings)


def _plan(title: str, runs: Iterable[PlannedRun], settings: Mapping[str, Any]) -> Plan:
    hints = SideHints.of(settings.get("columns"), settings.get("frame_rate"))
    runs = tuple(dataclasses.replace(run, hints=hints) for run in runs)
    return Plan(title, runs, _request({}, settings), bool(settings.get("common_time_span")))


def _plan_of_yaml(target: Path, settings: Mapping[str, Any], hosts: frozenset[str]) -> Plan:
    if not target.exists():
        raise InputError(
            f"{target} does not exist; give a YAML configuration, a manifest (.csv or .parquet), "
            "or a folder in the layout of ov_eval or rpg_trajectory_evaluation"
        )
    if target.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"{target} is not a comparison; give a YAML file (.yaml), a manifest, a folder, or a "
            "groundtruth and its estimates"
        )
    config = read_mapping(target, "comparison")
    require_known(config, [*_KEYS, *_OF_COMPARISONS, *settings_of_many_runs()], str(target))
    if (common_time_span := settings.get("common_time_span")) is None:
        common_time_span = _typed(config, "common_time_span", bool, target, default=False)
    listed = "manifest" in config
    runs = _listed_runs(config, target, hosts) if listed else _runs(config, target, hosts)
    algorithms = list(dict.fromkeys(run.algorithm for run in runs))
    hints = _hints(config, target, algorithms, settings)
    return Plan(
        title=_typed(config, "title", str, target, default=target.stem),
        runs=tuple(dataclasses.replace(run, hints=hints[run.algorithm]) for run in runs),
        request=_request(_settings(config, target), settings),
        common_time_span=bool(common_time_span),
    )


def _listed_runs(
    config: Mapping[str, Any], target: Path, hosts: frozenset[str]
) -> tuple[PlannedRun, ...]:
    """Return the runs of the manifest that a YAML file names."""
    for key in ("groundtruth", "runs", "sequences", "trials"):
        if key in config:
            raise InputError(f"{target}: manifest and {key} exclude each other; remove one")
    manifest = _typed(config, "manifest", str, target)
    if not is_manifest(manifest):
        raise InputError(f"{target}: {manifest} is not a manifest; give a .csv or .parquet file")
    if is_url(manifest):
        require_allowed(manifest, hosts, str(target))
        return runs_in_manifest(manifest, hosts)
    return runs_in_manifest(str(_folder_of(config, target) / manifest), hosts)


def _folder_of(config: Mapping[str, Any], target: Path) -> Path:
    folder: str = _typed(config, "folder", str, target, default=".")
    return target.parent / folder


def _runs(
    config: Mapping[str, Any], target: Path, hosts: frozenset[str]
) -> tuple[PlannedRun, ...]:
    """Return the runs that the patterns of a YAML file match, and missing ones."""
    for key in ("groundtruth", "runs"):
        if key not in config:
            raise InputError(
                f"{target} has no {key!r}, which defines the files to compare; add it, or name a "
                "manifest"
            )
    folder = _folder_of(config, target)
    patterns = config["runs"]
    if not isinstance(patterns, dict) or not patterns:
        raise InputError(
            f"{target}: runs must be a mapping of algorithms to patterns, as in "
            '{vio: "vio/{sequence}.txt"}'
        )
    groundtruth = Pattern.parse(_typed(config, "groundtruth", str, target, default=""))
    if groundtruth.has_trials:
        raise InputError(f"{target}: groundtruth is the same for all trials; remove {{trial}}")
    algorithms = {
        str(name): Pattern.parse(_typed(patterns, name, str, target, default=""))
        for name in patterns
    }
    for item in (groundtruth, *algorithms.values()):
        if is_url(item.path):
            require_allowed(item.text, hosts, str(target))
    sequences = _names(config, "sequences", target)
    sources = groundtruth.find(folder)
    groundtruth.require(sources, folder)
    groundtruths = {sequence: source for (sequence, _), source in sources.items()}
    estimates: dict[Name, str] = {}
    for algorithm, pattern in algorithms.items():
        sources = pattern.find(folder)
        if not sequences:  # with a list of sequences, missing runs are reported as failed
            pattern.require(sources, folder)
        estimates |= {(algorithm, *run): source for run, source in sources.items()}
    return all_runs(
        algorithms,
        estimates,
        lambda _, sequence: groundtruths.get(sequence, ""),
        lambda name: algorithms[name[0]].path_of(folder, *name[1:]),
        sequences=sequences,
        trials=_names(config, "trials", target),
    )


def _hints(
    config: Mapping[str, Any], target: Path, algorithms: Sequence[str], settings: Mapping[str, Any]
) -> dict[str, SideHints]:
    """Return the hints for the text files of both sides, by algorithm."""
    columns, frame_rate = settings.get("columns"), settings.get("frame_rate")
    if frame_rate is None and "frame_rate" in config:
        frame_rate = _typed(config, "frame_rate", float, target)
    if columns:
        return dict.fromkeys(algorithms, SideHints.of(columns, frame_rate))
    given = config.get("columns", {})
    if isinstance(given, dict):
        written = {str(name): item for name, item in given.items()}
    else:
        written = dict.fromkeys(algorithms, _typed(config, "columns", str, target))
    require_known(written, [*algorithms, GROUNDTRUTH], f"{target}: columns")
    of_both = []
    if GROUNDTRUTH in written:
        of_both = [f"{GROUNDTRUTH}: {_typed(written, GROUNDTRUTH, str, target)}"]
    try:
        return {
            name: SideHints.of(
                [*of_both, *([_typed(written, name, str, target)] if name in written else [])],
                frame_rate,
            )
            for name in algorithms
        }
    except SettingsError as error:
        raise InputError(f"{target}: {error}") from error


def _settings(config: Mapping[str, Any], target: Path) -> dict[str, Any]:
    """Return the settings of a request in the form of the command line."""
    try:
        settings = {
            name: setting.of_yaml(config[name])
            for name, setting in settings_of_many_runs().items()
            if name in config
        }
    except SettingsError as error:
        raise InputError(f"{target}: {error}") from error
    if is_protocol_file(settings.get("protocol", "")):
        settings["protocol"] = str(target.parent / settings["protocol"])
    if settings.get("hand_eye", NONE) not in (NONE, AUTO):
        settings["hand_eye"] = str(target.parent / settings["hand_eye"])
    return settings


def _request(written: Mapping[str, Any], given: Mapping[str, Any]) -> Request:
    """Return the request of a file's settings; settings of the command line override them."""
    given = {
        name: value
        for name, value in given.items()
        if value is not None and name not in _OF_COMPARISONS
    }
    if "gauge" in given or "modality" in given:
        written = {key: item for key, item in written.items() if key not in ("gauge", "modality")}
    settings = {**written, **given}
    if settings.get("covariance", NONE) not in (NONE, MESSAGE):
        raise SettingsError(
            f"covariance {settings['covariance']!r} is for a single run; use covariance message, "
            "or evaluate that run with trajeval evaluate"
        )
    try:
        request = request_from(settings)
    except SettingsError as error:
        if given:
            raise
        raise SettingsError(in_names_of_settings(str(error))) from error
    if request.states_table:
        raise SettingsError(
            "a comparison needs a single value of align states; give all or one number, or use "
            "trajeval evaluate for a table of several"
        )
    return dataclasses.replace(request, lengths_of_groundtruth=True)


def _names(config: Mapping[str, Any], key: str, target: Path) -> list[str]:
    value = config.get(key, [])
    if not isinstance(value, list):
        raise InputError(f"{target}: {key} must be a list of names, not {value!r}")
    for item in value:
        if not isinstance(item, str) and not (key == "trials" and type(item) is int):
            raise InputError(
                f"{target}: {item!r} in {key} is not text; write names such as 00 in quotes"
            )
    names = [str(item) for item in value]
    twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if twice:
        raise InputError(f"{target}: {key} lists {twice[0]} twice; remove one")
    return names


def _typed(
    config: Mapping[str, Any], key: str, kind: type, target: Path, *, default: Any = None
) -> Any:
    value = config.get(key, default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind):
        what = {str: "a text", float: "a number", bool: "true or false"}[kind]
        raise InputError(f"{target}: {key} must be {what}, not {value!r}")
    return value
