"""Numbers that other programs computed of the pairs in data/parity, compared with ours.

A reference is one run of a program; a row is one quantity of it, such as the rotation error.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from paths import TESTS

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import protocol_from, read_protocol
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.evaluation import Evaluation, evaluate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics

FOLDER = TESTS / "data" / "parity"
REFERENCES: dict[str, Any] = json.loads((FOLDER / "references.json").read_text(encoding="utf-8"))
ENTRIES: list[dict[str, Any]] = [
    *REFERENCES["references"],
    *json.loads((FOLDER / "pose_relations.json").read_text(encoding="utf-8")),
]
PAIRS: dict[str, dict[str, str]] = REFERENCES["pairs"]
STATISTICS = ("rmse", "mean", "median", "std", "min", "max")

# Of evo's pose relations: our metric, and their unit in ours.
EVO_RELATIONS = {
    "trans_part": ("position_m", 1.0),
    "angle_deg": ("rotation_deg", 1.0),
    "angle_rad": ("rotation_deg", math.radians(1.0)),
    "rot_part": ("rotation_part", 1.0),
    "full": ("full", 1.0),
    "point_distance": ("distance_m", 1.0),
    "point_distance_error_ratio": ("distance_percent", 1.0),
}
RPG_METRICS = {
    "abs_e_trans_stats": "position_m",
    "abs_e_rot_stats": "rotation_deg",
    "rel_trans_stats": "position_m",
    "rel_trans_perc_stats": "position_percent",
    "rel_rot_stats": "rotation_deg",
    "rel_rot_deg_per_m_stats": "rotation_deg_per_m",
    "rel_yaw_stats": "yaw_deg",
    "rel_gravity_stats": "tilt_deg",
}
# Where trajeval gives another number than the program, which is a defect of trajeval.
REPAIRED = "matrices are made rotations, and evo aligns by the matrices as they are in the file"


@dataclass(frozen=True)
class Setting:
    """Options of `trajeval evaluate`; `protocol_text` is a protocol file's content."""

    protocol: str
    gauge: str | None = None
    align_states: str | None = None
    max_time_difference: float | None = None
    time_offset: float | None = None
    lengths: str | None = None
    protocol_text: str | None = None

    def words(self, pair: str, folder: Path) -> list[str]:
        """Return the command; a protocol file goes to the folder."""
        files = {name: str(FOLDER / "pairs" / file) for name, file in PAIRS[pair].items()}
        options = {**files, **dataclasses.asdict(self)}
        if options.pop("protocol_text"):
            options["protocol"] = str(self.write_protocol(folder))
        return ["evaluate"] + [
            f"--{name.replace('_', '-')}={value}"
            for name, value in options.items()
            if value is not None
        ]

    def write_protocol(self, folder: Path) -> Path:
        assert self.protocol_text is not None
        file = folder / f"{self.protocol}.yaml"
        file.write_text(self.protocol_text, encoding="utf-8")
        return file

    def evaluate(self, pair: str) -> Evaluation:
        """Do in process what the command does."""
        base: str | Protocol = self.protocol
        if self.protocol_text is not None:
            with tempfile.TemporaryDirectory() as folder:
                base = read_protocol(self.write_protocol(Path(folder)))
        protocol = protocol_from(
            base,
            gauge=self.gauge,
            modality=None,
            align_states=self.align_states,
            association=None,
            max_time_difference=self.max_time_difference,
            max_gap=None,
            time_offset=self.time_offset,
            lengths=self.lengths,
        )
        files = PAIRS[pair]
        return evaluate(read(files["groundtruth"]), read(files["estimate"]), protocol)


@functools.cache
def read(name: str) -> Trajectory:
    return read_trajectory(str(FOLDER / "pairs" / name))


@functools.cache
def evaluated(pair: str, setting: Setting) -> Evaluation:
    return setting.evaluate(pair)


def of_length(evaluation: Evaluation, length_m: float) -> SubTrajectoryErrors:
    assert evaluation.relative is not None
    return next(item for item in evaluation.relative if item.length_m == length_m)


@dataclass(frozen=True, eq=False)
class Row:
    """One quantity of one run of a program.

    Attributes:
        pair: Name of the pair of files.
        tool: evo or rpg.
        quantity: As the program names it; "" where it refused.
        entry: The whole reference.
        unanswered: Why trajeval isn't compared with it; None if it is.
        setting: How trajeval computes it; None where nothing does.
        relative: Whether it is an error of sub-trajectories.
    """

    pair: str
    tool: str
    quantity: str
    entry: dict[str, Any]
    unanswered: str | None
    setting: Setting | None = None
    relative: bool = False

    def __str__(self) -> str:
        return f"{self.entry['call']}: {self.quantity}"

    @property
    def repaired(self) -> bool:
        """Whether evo used matrices as they are, and trajeval the nearest rotations."""
        return bool(self.entry.get("note") == "raw")

    @property
    def rotational(self) -> bool:
        return self.unit.startswith("deg")

    @property
    def unit(self) -> str:
        return str(self.entry["results"][self.quantity]["unit"])

    def computed(self) -> Statistics | None:
        assert self.setting is not None
        evaluation = evaluated(self.pair, self.setting)
        if self.tool == "evo":
            return self._ours_by_evo(evaluation)
        metric = RPG_METRICS[self.quantity]
        if not self.relative:
            return evaluation.ate[metric]
        return of_length(evaluation, self.entry["length_m"]).statistics[metric]

    def _ours_by_evo(self, evaluation: Evaluation) -> Statistics | None:
        metric, unit = EVO_RELATIONS[self.quantity]
        if self.relative:
            assert evaluation.relative is not None
            actual = evaluation.relative[0].statistics[metric]
        else:
            # Of single states evo's distance of points is the error of position.
            metric = "position_m" if self.quantity == "point_distance" else metric
            actual = evaluation.ate[metric]
        return actual if actual is None or unit == 1.0 else actual.scaled(unit)

    def disagreement(self, *, of_raw: bool = True) -> str | None:
        """Say how the numbers differ; None if they don't.

        Args:
            of_raw: Allow for what repairing the matrices of the file changes.
        """
        theirs = self.entry["results"][self.quantity]
        try:
            actual = self.computed()
        except TrajevalError as error:
            return f"{self}: {error}"
        if actual is None or actual.count != theirs["pairs"]:
            return f"{self}: {theirs['pairs']} pairs, not {actual and actual.count}"
        for name in STATISTICS:
            if name in theirs:
                value, difference = theirs[name], abs(getattr(actual, name) - theirs[name])
                if not difference <= self.tolerance(value, of_raw=of_raw):
                    return f"{self}: {name} {value} differs by {difference:.3g}"
        return None

    def tolerance(self, value: float, *, of_raw: bool) -> float:
        """Return by how much two correct programs may differ, in the row's unit.

        1e-8 of the number is far more than rounding, except in the cases below.
        """
        tolerance = max(1e-8 * abs(value), 1e-10)
        if self.repaired and of_raw:
            # Matrices of 9 decimals are rotations to 1e-9. That is a part of 1e-7 of positions
            # that they turn; of an angle of 1e-4 rad, from its cosine, 1e-5.
            share = max((1e-5 if self.rotational else 1e-7) * abs(value), 1e-10)
            return max(share, 2e-9 * self._turned_m())
        if self.entry.get("note") == "ulp" and not self.rotational:
            # Coordinates of 5e6 m: a float64 step is 9.3e-10 m, and a difference has three axes.
            return max(tolerance, 3e-9 * self._units_per_metre())
        rotated = {"full": math.sqrt(2.0), "rot_part": math.sqrt(2.0), "angle_rad": 1.0}
        rotations = rotated.get(self.quantity, math.degrees(1.0) if self.rotational else None)
        if self.pair == "straight_flat" and rotations is not None and not self.relative:
            # Of L = 240 m, both sides share w = 1 cm to the side of the line: the rotation about
            # it is determined to some 16 eps (L^2 / 12) / w^2.
            return rotations * 16.0 * 2.0**-52 * (240.0**2 / 12.0) / 0.01**2
        if self.tool == "rpg" and RPG_METRICS.get(self.quantity, "").startswith("rotation"):
            # An angle from its arc cosine: an error e of the cosine is e / angle of the angle.
            # The cosine is half a trace of 27 products, hence some 16 roundings of eps.
            per_degree = 1.0 if self.unit == "deg" else 1.0 / self.entry["length_m"]
            angle = math.radians(max(value / per_degree, 1e-3))
            rounding = math.degrees(16.0 * 2.0**-52 / angle)
            return max(tolerance, rounding * per_degree)
        if self.pair == "straight_flat" and not self.rotational and not self.relative:
            # L = 240 m long and straight to w = 5 cm: positions determine the rotation about
            # the line to some 16 eps (L^2 / 12) / w^2, which moves poses by w times that.
            return max(tolerance, 16.0 * 2.0**-52 * (240.0**2 / 12.0) / 0.05)
        return tolerance

    def _turned_m(self) -> float:
        """Return the length of the steps that the first matrices of both sides turn, metres.

        With entries that are wrong by up to 5e-10 each of them is wrong by up to sqrt(3) 5e-10 of
        its length.
        """
        assert self.setting is not None
        segments = evaluated(self.pair, self.setting).relative if self.relative else None
        return segments[0].mean_length_m or 0.0 if segments else 0.0

    def _units_per_metre(self) -> float:
        return 100.0 / float(self.entry["length_m"]) if self.unit == "%" else 1.0
