"""The definitions that are searched: their settings, prior probabilities and commands.

The priors are set by hand, as a product: of association, alignment, metric and statistic. The
defaults of evo, rpg_trajectory_evaluation and KITTI's devkit are the likeliest.
"""

from __future__ import annotations

import dataclasses
from typing import Final, NamedTuple

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AssociationRule
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol

EXCHANGED: Final = "evo, sides exchanged"
# By name: the protocol that has the association, its rule, and its prior.
ASSOCIATIONS: Final[dict[str, tuple[str, AssociationRule, float]]] = {
    "evo": ("evo", AssociationRule("evo", 0.01), 1.0),
    "rpg": ("rpg", AssociationRule("rpg", 0.02), 0.7),
    "linear": ("default", AssociationRule("linear"), 0.3),
    "evo within 0.02 s": ("evo", AssociationRule("evo", 0.02), 0.08),
    "evo within 0.05 s": ("evo", AssociationRule("evo", 0.05), 0.05),
    AT_GROUNDTRUTH: ("default", AssociationRule(AT_GROUNDTRUTH), 0.03),
    EXCHANGED: ("evo", AssociationRule("evo", 0.01), 0.03),
    "rpg within 0.05 s": ("rpg", AssociationRule("rpg", 0.05), 0.02),
    "rpg within 0.01 s": ("rpg", AssociationRule("rpg", 0.01), 0.02),
    "index": ("evo", AssociationRule("index"), 1.0),  # of KITTI's files, by frame
}


class Aligning(NamedTuple):
    """An alignment: its settings in a protocol, and its prior."""

    gauge: Gauge
    states: int | None
    prior: float
    apply: str = "all"
    scaled_by: str = ""  # an alignment; its scale is applied before that by the first state

    @property
    def has_scale(self) -> bool:
        """Whether it changes the scale."""
        return self.gauge.has_scale or bool(self.scaled_by)


ALIGNMENTS: Final[dict[str, Aligning]] = {
    "se3": Aligning(Gauge.SE3, None, 1.0),
    "sim3": Aligning(Gauge.SIM3, None, 0.9),
    "yaw": Aligning(Gauge.YAW, None, 0.7),
    "none": Aligning(Gauge.NONE, None, 0.3),
    "se3 by the first state": Aligning(Gauge.SE3, 1, 0.3),
    "yaw by the first state": Aligning(Gauge.YAW, 1, 0.2),
    "translation": Aligning(Gauge.TRANSLATION, None, 0.02),
    "translation by the first state": Aligning(Gauge.TRANSLATION, 1, 0.03),
    "scale of sim3 alone": Aligning(Gauge.SIM3, None, 0.05, apply="scale"),
    "scale of sim3, then se3 by the first state": Aligning(Gauge.SE3, 1, 0.05, scaled_by="sim3"),
} | {
    f"{gauge.value} by the first {states} states": Aligning(gauge, states, 0.02)
    for states in (10, 50, 100, 200)
    for gauge in (Gauge.SE3, Gauge.YAW, Gauge.SIM3)
}
_MAIN = tuple(ALIGNMENTS)[:6]
_TURNED = tuple(
    name
    for name, item in ALIGNMENTS.items()
    if not item.has_scale and item.gauge is not Gauge.TRANSLATION
)
_OF_UP = ("horizontal", "vertical", "yaw", "tilt")
LAST: Final = "last"  # the error at the end
_FEW, _ALL = ("rmse", "mean", "median"), ("rmse", "mean", "median", "std", "max", "p95")
PER_AXIS: Final = "per axis"
PER_PATH: Final = "in % of the path"
# By metric of result.json and form: statistics and alignments that are searched, and the prior.
ABSOLUTE: Final[dict[tuple[str, str], tuple[tuple[str, ...], tuple[str, ...], float]]] = {
    ("position_m", ""): ((*_ALL, LAST), tuple(ALIGNMENTS), 1.0),
    ("position_m", PER_AXIS): (("rmse",), _MAIN, 0.015),
    ("position_m", PER_PATH): (("rmse", "mean", LAST), _MAIN, 0.07),
    ("rotation_deg", ""): (_ALL, _TURNED, 0.35),
    ("horizontal_m", ""): (("rmse", "mean"), _MAIN, 0.07),
    ("vertical_m", ""): (("rmse", "mean"), _MAIN, 0.015),
    ("yaw_deg", ""): (_FEW, _TURNED[:5], 0.06),
    ("tilt_deg", ""): (_FEW, _TURNED[:5], 0.02),
    ("full", ""): (_ALL, ("se3",), 0.015),
    ("rotation_part", ""): (_ALL, ("se3",), 0.015),
}
_OF_EVO = ("full", "rotation_part")  # errors of whole poses, which only evo's form has


class Family(NamedTuple):
    """Relative errors of a program: the protocol, its lengths, and what is searched."""

    protocol: str
    lengths: str
    associations: tuple[str, ...]
    metrics: dict[str, tuple[str, ...]]  # of every length, with their statistics
    prior: float = 0.05  # of its lengths
    pooled: tuple[str, ...] = ()  # statistics of the drift over all lengths
    pairs: str = ""  # `all` for all pairs of states instead of consecutive ones


KITTI: Final = "kitti"
_PAIRED = ("rpg", "linear", AT_GROUNDTRUTH, "index")
_POSE: dict[str, tuple[str, ...]] = {"position_m": _ALL, "rotation_deg": _ALL}
_PARTS: dict[str, tuple[str, ...]] = {
    "position_percent": _ALL, "rotation_deg_per_m": _ALL, "yaw_deg": _FEW, "tilt_deg": _FEW,
}  # fmt: skip
FAMILIES: Final[dict[str, Family]] = {
    "rpg": Family("rpg", "10%,20%,30%,40%,50%", _PAIRED, _POSE | _PARTS, pooled=_FEW),
    "rpg, metres": Family("rpg", "8,16,24,32,40", ("rpg", "index"), _POSE),
    "evo": Family("evo", "1f,10f,1,10", ("evo", "index"), _POSE, prior=0.1),
    "evo, all pairs": Family("evo", "1,10", ("evo", "index"), _POSE, pairs="all"),
    "metres": Family("default", "8,16,24,32,40", ("linear",), _POSE),
    "seconds": Family("evo", "1s", ("evo", "rpg", "linear"), _POSE, pairs="all"),
    KITTI: Family(
        "kitti", "100,200,300,400,500,600,700,800", ("evo", "linear", "index"), {}, 1.0, ("mean",)
    ),
}
POOLED: Final = "pooled"
_UNITS = {"_per_m": "deg/m", "_percent": "%", "_deg": "deg", "_m": "m"}  # by the end of a metric
_STATISTICS = {"rmse": 1.0, "mean": 0.3, "median": 0.15, "max": 0.08, "p95": 0.01, LAST: 0.02}
_OF_RELATIVE = {"rmse": 0.8, "mean": 1.0, "median": 0.8}
_DEFAULT_LENGTHS = {"1f": 0.3}  # of evo_rpe
_OTHER = 0.05


class Definition(NamedTuple):
    """A definition of a number: names of the tables above, and of entries of result.json."""

    association: str
    alignment: str  # of relative errors: the alignment whose scale they have
    metric: str
    statistic: str
    form: str = ""
    family: str = ""  # empty for absolute errors
    length: str = ""  # of the sub-trajectories, or `pooled`; empty for absolute errors

    @property
    def unit(self) -> str:
        """The unit of the number; empty for errors of whole poses, which have none."""
        if self.form == PER_PATH:
            return "%"
        return next((unit for end, unit in _UNITS.items() if self.metric.endswith(end)), "")

    @property
    def prior(self) -> float:
        """The prior probability, relative to other definitions."""
        factor = ASSOCIATIONS[self.association][2] * ALIGNMENTS[self.alignment].prior
        if self.family:
            of_family = _DEFAULT_LENGTHS.get(self.length, FAMILIES[self.family].prior)
            return factor * of_family * _OF_RELATIVE.get(self.statistic, _OTHER)
        of_metric = ABSOLUTE[self.metric, self.form][2]
        return factor * of_metric * _STATISTICS.get(self.statistic, _OTHER)

    def is_searched(self, withheld: bool) -> bool:
        """Return whether a program prints the number; protocols of this package withhold some."""
        protocol = ASSOCIATIONS[self.association][0]
        if withheld and protocol == "default":
            return False
        if self.family:
            return self.association in FAMILIES[self.family].associations
        return self.metric not in _OF_EVO or PROTOCOLS[protocol].ate_form == "evo"

    def __str__(self) -> str:
        """Return everything but the association, as text."""
        name, _, unit = self.metric.partition("_")
        of = {"percent": " in %", "deg_per_m": " per m", "part": " part"}.get(unit, "")
        over = f" over {self.length} ({self.family})" if self.family else ""
        return f"{name}{of} {self.statistic} {self.form}".rstrip() + f"{over}, {self.alignment}"


def protocol_of(association: str, alignment: str, family: str = "") -> Protocol:
    """Return the settings of definitions."""
    (name, rule, _), aligning = ASSOCIATIONS[association], ALIGNMENTS[alignment]
    searched = FAMILIES.get(family)
    base = PROTOCOLS[searched.protocol if searched else name]
    pairs = (searched and searched.pairs) or base.selection.pairs
    return dataclasses.replace(
        base,
        gauge=aligning.gauge,
        align_states=aligning.states,
        apply=aligning.apply,
        association=rule,
        lengths=searched.lengths if searched else "none",
        selection=dataclasses.replace(base.selection, pairs=pairs),
    )


class Command(NamedTuple):
    """What prints a number: options of `trajeval evaluate`, and entries of result.json."""

    options: tuple[str, ...]  # after groundtruth and estimate
    formula: str  # of entries of result.json
    exchanged: bool  # whether groundtruth and estimate change places
    file: str  # content of the file protocol.yaml; empty if the options name none


def command_of(definition: Definition, up: tuple[str, str] = ("z", "z")) -> Command | str:
    """Return the command that prints the number of a definition, or why there is none.

    `up`: the vertical axes of groundtruth and estimate. They are given, because numbers that
    depend on an assumed axis are withheld if it is probably another one.
    """
    aligning = ALIGNMENTS[definition.alignment]
    if aligning.scaled_by:
        return (
            "no command gives this number: no option aligns by the first state after a scale; "
            "first convert the estimate by trajeval trajectory --scale"
        )
    if definition.statistic == LAST:
        return (
            "no command gives this number: result.json has no error at the end; it is the last "
            "position_m of errors.npz"
        )
    protocol = protocol_of(*definition[:2], definition.family)
    base, rule, options, file = PROTOCOLS[protocol.name], protocol.association, [], ""
    if aligning.apply != base.apply:
        file = f"base: {base.name}\ngauge: {aligning.gauge.value}\napply: {aligning.apply}\n"
    elif protocol.selection != base.selection:
        file = f"base: {base.name}\nsub_trajectories: {protocol.selection.pairs}\n"
    if file or base.name != "default":
        options += ["--protocol", "protocol.yaml" if file else base.name]
    if rule.method != base.association.method:
        options += ["--association", rule.method]
    limit_s = rule.max_time_difference_s
    if rule.method in ("evo", "rpg") and limit_s != base.association.max_time_difference_s:
        options += ["--max-time-difference", f"{limit_s:g}"]
    options += ["--gauge", aligning.gauge.value]
    if aligning.states:
        options += ["--align-states", str(aligning.states)]
    is_exchanged = definition.association == EXCHANGED
    if definition.metric.startswith(_OF_UP):
        options.append("--up=" + ",".join(dict.fromkeys(up[::-1] if is_exchanged else up)))
    path = f"ate.{definition.metric}.{definition.statistic}"
    if definition.family:
        path = f"re.{definition.length}.{definition.metric}.{definition.statistic}"
        if definition.length not in (POOLED, *map(str, base.lengths)):
            options += ["--lengths", definition.length]
    formula = {
        PER_AXIS: f"{path} / sqrt(3)", PER_PATH: f"100 * {path} / groundtruth.path_length_m"
    }.get(definition.form, path)  # fmt: skip
    return Command(tuple(options), formula, is_exchanged, file)
