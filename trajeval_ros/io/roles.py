"""The likely evaluation of a recording: groundtruth, estimates and sensors, with reasons.

Roles follow from names and types of topics, sensors from the estimator's name, its motion and the
other topics. Nothing is certain, so every choice has a sentence with the option that changes it.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.gauge import MODALITIES
from trajeval_ros.io.describe import Description, TrajectorySummary, describe
from trajeval_ros.io.sources import Advance

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory

GROUNDTRUTH, COMMAND = "groundtruth", "command"
MOST_SOURCES = 20  # in a folder of one run; all of them are read
# Names of groundtruth in the order of preference: a simulator's or a dataset's, a measured one.
_PREFERRED = re.compile(r"(gt|(?<![a-z])(ground.?)?truth)(?![a-z])", re.IGNORECASE)
STILL = 0.01  # of the longest path: a shorter one is a calibration or a marker, no trajectory
# Sensors by words in an estimate's topic; the first match applies.
_WORDS = (
    ("lidar-inertial", r"[a-z]*(lio|livo)|lvi"),
    ("lidar", r"loam|kiss|lidar|g?icp|ndt|hdl|cartographer"),
    ("stereo-inertial", r"[a-z]*(vio|vins)|msckf|okvis|basalt|kimera"),
    ("rgbd", r"rtabmap|rgbd"),
    ("wheel", r"wheels?|diff_?drive|velocity_controller|ackermann|encoders?"),
)
_CAMERAS = {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"}
_FIXES = 2  # rank of groundtruth from GNSS, the last
_IMU, _LIDAR = "sensor_msgs/msg/Imu", "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True)
class LikelyEvaluation:
    """Sources of an evaluation, and why they were chosen."""

    groundtruth: str  # SOURCE; "" if no topic is likely
    estimates: tuple[str, ...]  # SOURCEs
    modality: str  # "" if nothing shows the sensors
    reasons: tuple[str, ...] = ()  # a sentence for each choice
    options: str = ""  # further options for the estimator

    def command(self, groundtruth: str = "GROUNDTRUTH", modality: str = "") -> str:
        """Return the command; the arguments replace what is unknown."""
        truth = shlex.quote(self.groundtruth) if self.groundtruth else groundtruth
        words = ["trajeval evaluate -g", truth]
        words += [f"-e {shlex.quote(estimate)}" for estimate in self.estimates]
        if sensors := self.modality or modality:
            words.append(f"--modality {sensors}")
        return " ".join([*words, *([self.options] if self.options else [])])


def likely_evaluations(
    description: Description, *, has_one_gauge: bool = False
) -> list[LikelyEvaluation]:
    """Return all evaluations that are equally likely; none without an estimate.

    Estimates of one evaluation have one gauge. Those of unknown sensors share it if it is the only
    one. Of several groundtruths, a simulator's or a dataset's one is preferred, and fixes are used
    only if there is no other. `has_one_gauge`: the user states the gauge, and no sensors follow.
    """
    usable = [summary for summary in description.trajectories if not summary.problem]
    omitted = _omitted(usable)
    usable = [summary for summary in usable if summary.source not in omitted]
    references = [summary for summary in usable if summary.could_be == GROUNDTRUTH]
    estimates = [summary for summary in usable if summary.could_be != GROUNDTRUTH]
    best = min(map(_rank, references), default=0)
    likely: list[TrajectorySummary | None] = [
        summary for summary in references if _rank(summary) == best
    ]
    # No name shows the groundtruth: no topic has a word for it, or both have.
    if not (references and estimates) and len(usable) == 2 and best != _FIXES:
        first, second = usable
        return [
            _evaluation(truth, [other], description)
            for truth, other in ((first, second), (second, first))
        ]
    groups: dict[object, list[TrajectorySummary]] = {}
    for estimate in estimates:
        gauge = MODALITIES.get(_sensors(estimate, description)[0])
        groups.setdefault(None if has_one_gauge else gauge, []).append(estimate)
    if len(groups) == 2 and None in groups:  # one gauge is known
        unknown = groups.pop(None)
        next(iter(groups.values())).extend(unknown)
    # Of several bags with groundtruth, every one is evaluated by its estimates, if it has any.
    bags = {_bag(truth.source) for truth in likely if truth}
    with_estimates = {_bag(estimate.source) for estimate in estimates}
    is_split = len(bags) > 1 and bags <= with_estimates
    return [
        _evaluation(
            truth,
            together,
            description,
            others=len(references) - 1,
            has_sensors=not has_one_gauge,
            omitted=tuple(omitted.values()),
        )
        for truth in likely or [None]
        for group in groups.values()
        if (
            together := [
                estimate
                for estimate in group
                if truth is None or not is_split or _bag(estimate.source) == _bag(truth.source)
            ]
        )
    ]


def describe_all(
    path: Path, read: dict[str, Trajectory], advance: Advance = lambda done, total: None
) -> Description:
    """Return the contents of a bag or log, or of all files in a folder.

    `read` receives the trajectories by their SOURCE, from bags without covariances.

    Raises:
        InputError: The folder has more sources than a run has.
    """
    from trajeval_ros.io.bags.bag_folder import holds_bag
    from trajeval_ros.io.find_sources import find_sources

    if not path.is_dir() or holds_bag(path):
        return describe(str(path), advance=advance, read=read, covariances=False)
    sources = find_sources(path).sources
    if len(sources) > MOST_SOURCES:
        raise InputError(
            f"{path} has {counted(len(sources), 'source')}, more than the {MOST_SOURCES} of one "
            f"run; compare many runs: trajeval compare {shlex.quote(str(path))}"
        )
    parts = []
    for place, source in enumerate(sources):
        advance(place, len(sources))
        parts.append(describe(str(source.path), read=read, covariances=False))
    return Description(
        path,
        tuple(summary for part in parts for summary in part.trajectories),
        others=tuple(row for part in parts for row in part.others),
    )


def _omitted(summaries: Sequence[TrajectorySummary]) -> dict[str, str]:
    """Return a sentence for the SOURCEs of commands and of poses that stand still.

    They are no trajectories of the body. Beside no other estimate, none is omitted.
    """
    omitted = {}
    estimates = [summary for summary in summaries if summary.could_be != GROUNDTRUTH]
    longest = max((summary.path_length_m for summary in summaries), default=0.0)
    for summary in estimates:
        reason = ""
        if summary.could_be == COMMAND:
            reason = "named as a command"
        elif summary.path_length_m < STILL * longest:
            reason = f"moves by {summary.path_length_m:.3g} m in all"
        if reason:
            topic = summary.topic
            omitted[summary.source] = f"{topic} omitted: {reason}; evaluate it with -e"
    return omitted if len(omitted) < len(estimates) else {}


def _rank(summary: TrajectorySummary) -> int:
    if summary.fixed:
        return _FIXES
    return 0 if _PREFERRED.search(f"{summary.topic} {summary.frame}") else 1


def _bag(source: str) -> str:
    """Return the bag of a SOURCE, or "" for a file."""
    return source.rpartition(":")[0]


def _evaluation(
    truth: TrajectorySummary | None,
    estimates: list[TrajectorySummary],
    description: Description,
    others: int = 0,
    *,
    has_sensors: bool = True,
    omitted: tuple[str, ...] = (),
) -> LikelyEvaluation:
    modality, why = _sensors(estimates[0], description) if has_sensors else ("", "")
    reasons = []
    if truth is not None:
        more = f"; {counted(others, 'other topic')} can be groundtruth, too" if others > 0 else ""
        how = "by its fixes" if truth.fixed else "by its name"
        if truth.could_be != GROUNDTRUTH:
            how = "undecided"
        reasons.append(f"groundtruth {truth.topic}: {how}{more}; change it with -g")
    reasons += [
        f"estimate {summary.topic}: not named as groundtruth; change it with -e"
        for summary in estimates
    ]
    reasons += omitted
    if modality:
        reasons.append(f"sensors {modality}: {why}; change them with --modality")
    elif has_sensors:
        reasons.append("sensors unknown; state them with --modality")
    # Options are of one system; other estimates would take them, too.
    options = {summary.system.options if summary.system else "" for summary in estimates}
    return LikelyEvaluation(
        "" if truth is None else truth.source,
        tuple(summary.source for summary in estimates),
        modality,
        tuple(reasons),
        options.pop() if len(options) == 1 else "",
    )


def _sensors(estimate: TrajectorySummary, description: Description) -> tuple[str, str]:
    """Return the modality of an estimate and the evidence; two empty texts without any."""
    topic = estimate.topic
    if estimate.system is not None and estimate.system.modality:
        return estimate.system.modality, f"{topic} looks like {estimate.system.name}"
    for modality, words in _WORDS:
        if re.search(rf"(^|[^a-z])({words})([^a-z]|$)", topic, re.IGNORECASE):
            return modality, f"by the name {topic}"
    if estimate.flat:
        return "wheel", f"the height of {topic} is constant"
    sent = [(name, kind) for name, kind, count, _ in description.others if count]
    kinds = {kind for _, kind in sent}
    images = {name.removesuffix("/compressed") for name, kind in sent if kind in _CAMERAS}
    cameras = {name for name in images if "depth" not in name}
    base, why = "", ""
    if cameras and _LIDAR not in kinds:
        base = "rgbd" if images != cameras else "mono" if len(cameras) == 1 else "stereo"
        why = f"the recording has {counted(len(cameras), 'camera')}"
    elif _LIDAR in kinds and not cameras:
        base, why = "lidar", "the recording has point clouds"
    if _IMU in kinds:
        why = "the recording has an IMU, and all sensors with an IMU have one gauge"
        return f"{base or 'stereo'}-inertial", why
    return base, why
