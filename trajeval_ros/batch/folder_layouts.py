"""Folders in the layouts of ov_eval and rpg_trajectory_evaluation."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from trajeval_ros.batch.plan import Name, PlannedRun, all_runs
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.io.yaml_file import read_mapping

_ESTIMATE = re.compile(r"stamped_(\w+?)_estimate(\d*)\.txt")
# The toolbox's names for the files of an estimator.
_KINDS = {"traj": "traj_est", "pose_graph": "pose_graph", "ba": "ba_estimate"}
_GROUNDTRUTH = "stamped_groundtruth.txt"
_TIMES = "start_end_time.yaml"
_ENDINGS = (".txt", ".csv")


def runs_in_folder(folder: Path) -> tuple[PlannedRun, ...]:
    """Return the runs in a folder of a known layout.

    ov_eval: `truths/SEQUENCE.txt`, `algorithms/ALGORITHM/SEQUENCE/TRIAL.txt`.
    rpg_trajectory_evaluation: `PLATFORM/ALGORITHM/PLATFORM_ALGORITHM_SEQUENCE/` with
    `stamped_groundtruth.txt` and `stamped_traj_estimate0.txt`, ...; the folder may also be
    a platform, an algorithm, or one experiment. An experiment with `start_end_time.yaml` is
    evaluated from `start_time_sec` to `end_time_sec`, timestamps of the groundtruth.
    """
    if (folder / "truths").is_dir() and (folder / "algorithms").is_dir():
        return _ov_eval(folder)
    levels = ["*/" * depth + _GROUNDTRUTH for depth in range(4)]  # those of the layout
    experiments = sorted(path.parent for level in levels for path in folder.glob(level))
    if experiments:
        return _rpg(experiments)
    raise InputError(
        f"{folder} is neither a folder of ov_eval (truths/SEQUENCE.txt, "
        "algorithms/ALGORITHM/SEQUENCE/TRIAL.txt) nor of rpg_trajectory_evaluation "
        f"(PLATFORM/ALGORITHM/PLATFORM_ALGORITHM_SEQUENCE/{_GROUNDTRUTH}); write a YAML "
        "configuration (docs/compare.md)"
    )


def _ov_eval(folder: Path) -> tuple[PlannedRun, ...]:
    groundtruths: dict[str, str] = {}
    for path in _texts(folder / "truths"):
        _add(groundtruths, path.stem, path)
    estimates: dict[Name, str] = {}
    algorithms = [path for path in sorted((folder / "algorithms").iterdir()) if path.is_dir()]
    for algorithm in algorithms:
        for sequence in sorted(path for path in algorithm.iterdir() if path.is_dir()):
            for path in _texts(sequence):
                _add(estimates, (algorithm.name, sequence.name, path.stem), path)
    if not estimates:
        raise InputError(
            f"{folder} has no estimates; add algorithms/ALGORITHM/SEQUENCE/TRIAL.txt (layout of "
            "ov_eval)"
        )
    return all_runs(
        [path.name for path in algorithms],
        estimates,
        lambda _, sequence: groundtruths.get(sequence, ""),
        lambda name: (
            str(folder / "algorithms" / Path(*filter(None, name)))
            + (".txt" if name[2] else "/TRIAL.txt")
        ),
    )


def _rpg(experiments: list[Path]) -> tuple[PlannedRun, ...]:
    groundtruths: dict[tuple[str, str], str] = {}
    estimates: dict[Name, str] = {}
    places = [_place(path) for path in experiments]
    if len(set(places)) < len(places):  # folders ALGORITHM/SEQUENCE
        places = [
            (platform, algorithm or path.resolve().parent.name, sequence)
            for path, (platform, algorithm, sequence) in zip(experiments, places, strict=True)
        ]
    several_platforms = len({platform for platform, _, _ in places}) > 1
    without: dict[tuple[str, str], str] = {}
    algorithms: dict[str, None] = {}
    having: set[str] = set()
    for path, (platform, algorithm, sequence) in zip(experiments, places, strict=True):
        matches = [(match, file) for file in sorted(path.iterdir())
                 if (match := _ESTIMATE.fullmatch(file.name))]  # fmt: skip
        whose = " ".join(filter(None, (platform if several_platforms else "", algorithm)))
        if not matches:
            without[whose, sequence] = str(path / _GROUNDTRUTH)
        for match, file in matches:
            name = " ".join(filter(None, (whose, _KINDS.get(match[1], match[1]))))
            _add(estimates, (name, sequence, match[2]), file)
            groundtruths[name, sequence] = str(path / _GROUNDTRUTH)
            algorithms[name] = None
            having.add(whose)
    if not estimates:
        raise InputError(
            f"{experiments[0]} has a {_GROUNDTRUTH}, but no estimate; add "
            "stamped_traj_estimate.txt, stamped_pose_graph_estimate.txt or "
            "stamped_ba_estimate.txt"
        )
    # An algorithm without any estimate has failed, and stays in the tables.
    for (whose, sequence), groundtruth in without.items():
        if whose not in having:
            algorithms[whose] = None
            groundtruths[whose, sequence] = groundtruth
    by_sequence = {sequence: path for (_, sequence), path in groundtruths.items()}
    runs = all_runs(
        algorithms,
        estimates,
        lambda algorithm, sequence: groundtruths.get((algorithm, sequence), by_sequence[sequence]),
        lambda name: f"estimate{name[2]} of {name[1]} by {name[0]}",
    )
    spans = {
        groundtruth: _time_span(Path(groundtruth).with_name(_TIMES))
        for groundtruth in groundtruths.values()
    }
    return tuple(dataclasses.replace(run, time_span=spans[run.groundtruth]) for run in runs)


def _time_span(path: Path) -> TimeSpan | None:
    """Return the time span in the file of an experiment; None without a file."""
    if not path.exists():
        return None
    bounds = read_mapping(path, "start and end of an experiment")
    start, end = (
        None if (value := bounds.get(f"{key}_time_sec")) is None else f"@{value}"
        for key in ("start", "end")
    )
    try:
        return TimeSpan.parse(start, end)
    except SettingsError as error:
        raise InputError(f"{path}: {error}") from error


def _place(experiment: Path) -> tuple[str, str, str]:
    """Return platform, algorithm and sequence of an experiment, by its path."""
    experiment = experiment.resolve()
    algorithm, platform = experiment.parent.name, experiment.parent.parent.name
    prefix = f"{platform}_{algorithm}_"
    if experiment.name.startswith(prefix):
        return platform, algorithm, experiment.name.removeprefix(prefix)
    return "", "", experiment.name


def _texts(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in _ENDINGS)


def _add(files: dict[str, str] | dict[Name, str], key: str | Name, path: Path) -> None:
    known: dict[str | Name, str] = files  # type: ignore[assignment]
    if key in known:
        raise InputError(f"two files for the same run: {known[key]} and {path}; remove one")
    known[key] = str(path)
