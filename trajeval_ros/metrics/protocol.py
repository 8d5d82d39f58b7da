"""Protocols: named sets of settings that reproduce published numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar, cast

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry.gauge import Gauge, gauge_for
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AUTO, AssociationRule
from trajeval_ros.metrics.score import KnotTable, PointTable, RecallRule
from trajeval_ros.metrics.sub_trajectories import Length, Selection, parse_lengths

ATE_FORMS = ("plain", "tutorial", "evo")
RE_FORMS = ("gauge", "se3", "tutorial", "euler", "fitted", "matrices", "evo")
NEES_FORMS = ("gauge", "as_published")
GROUNDTRUTH_WEIGHTS = "groundtruth-covariance"
ALIGN_WEIGHTS = ("none", "covariance", GROUNDTRUTH_WEIGHTS)
ALIGN_WITH = ("positions", "poses")
APPLY = ("all", "scale")
_BETWEEN = (AUTO, "linear", "continuous")  # these can interpolate the groundtruth
# Protocols that reproduce the numbers of another program.
_OF_PROGRAMS = ("rpg", "evo", "kitti", "ov_eval")

_Given = TypeVar("_Given")
_Stored = TypeVar("_Stored")
_Lengths: TypeAlias = "Iterable[Length | float | str] | str"
_Vector: TypeAlias = tuple[float, float, float]


def metres(*values: float) -> tuple[Length, ...]:
    """Return lengths in metres."""
    return tuple(Length(value, "m") for value in values)


DEFAULT_LENGTHS = metres(8, 16, 24, 32, 40)


def _lengths(lengths: _Lengths) -> tuple[Length, ...]:
    if isinstance(lengths, str):
        return parse_lengths(lengths)
    if not isinstance(lengths, Iterable):
        raise SettingsError(f"lengths must be a sequence, as in (8, 16), not {lengths!r}")
    return tuple(Length.of(length) for length in lengths)


def _vector(lever_m: Sequence[float] | None) -> _Vector | None:
    if lever_m is None:
        return None
    try:
        x, y, z = (float(component) for component in lever_m)
    except (TypeError, ValueError):
        raise SettingsError(
            f"a lever arm must be three numbers in metres, not {lever_m!r}"
        ) from None
    return x, y, z


def _named(kind: Callable[[str], _Stored], value: _Stored | str) -> _Stored:
    return kind(value) if isinstance(value, str) else value


class _Converted(Generic[_Given, _Stored]):
    """A field that is given as one type, and is another one after `__post_init__`."""

    def __init__(self, default: _Given) -> None:
        self._default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, owner: type) -> _Stored:
        stored = self._default if instance is None else vars(instance)[self._name]
        return cast(_Stored, stored)

    def __set__(self, instance: object, value: _Given) -> None:
        vars(instance)[self._name] = value


@dataclass(frozen=True)
class Protocol:
    """All settings of an evaluation. Strings and numbers are converted and checked.

    `dataclasses.replace` makes a variant. For other sensors use
    `replace(protocol, gauge=None, modality="mono")`.

    Attributes:
        name: Name of the set of settings that it is based on.
        gauge: Group of the alignment, or its name; default: the modality's gauge, or `se3`.
        modality: Sensor set that determines the gauge (tutorial, Table I), or None.
        align_states: Number of first pairs to align by; None for all.
        align_with: `positions`, or `poses` to include orientations: see `alignment.solve`.
        apply: Part of the alignment that is applied: `all`, or only the `scale` of `sim3` about
            the origin, as evo_ape -s does.
        align_weights: `none`, `covariance` for weights by the estimate's position covariances,
            or `groundtruth-covariance` for weights by the groundtruth's.
        association: The association's rule, or the name of its method.
        in_order: Sort states by timestamp and drop repeated timestamps first.
        ate_form: `plain`; `tutorial` for eq. (23) to the letter; `evo` for plain errors and the
            errors of whole poses (`pose_relations`).
        re_form: See `relative_errors.relative_errors`.
        nees_form: `gauge`, with covariances in the gauge of the alignment, or `as_published`.
        lengths: Lengths of sub-trajectories: metres as numbers, texts such as "1s" or "10%", or
            `Length`; empty for no relative errors.
        selection: Rule for the ends of sub-trajectories, or its name.
        lever_m: Position of the groundtruth's point in the estimate's body, metres; None if the
            groundtruth has poses of the body.
        score: Table of points per position error; None for no score.
        recall: Error bounds within which a groundtruth point is found; None for no recall.

    Raises:
        SettingsError: An unknown name, a gauge that contradicts the modality, or settings that
            exclude one another.

    Example:
        >>> from trajeval_ros import Protocol
        >>> protocol = Protocol(modality="mono-inertial", lengths=(8, "1s", "10%"))
        >>> protocol.gauge.value, [str(length) for length in protocol.lengths]
        ('yaw', ['8m', '1s', '10%'])
        >>> Protocol(gauge="yaw", lengths="none").lengths
        ()
    """

    name: str = "default"
    gauge: _Converted[Gauge | str | None, Gauge] = _Converted(None)
    modality: str | None = None
    align_states: int | None = None
    align_with: str = "positions"
    apply: str = "all"
    align_weights: str = "none"
    association: _Converted[AssociationRule | str, AssociationRule] = _Converted(AUTO)
    in_order: bool = True
    ate_form: str = "plain"
    re_form: str = "gauge"
    nees_form: str = "gauge"
    lengths: _Converted[_Lengths, tuple[Length, ...]] = _Converted(DEFAULT_LENGTHS)
    selection: _Converted[Selection | str, Selection] = _Converted("nearest")
    lever_m: _Converted[Sequence[float] | None, _Vector | None] = _Converted(None)
    score: PointTable | KnotTable | None = None
    recall: RecallRule | None = None

    def __post_init__(self) -> None:
        """Convert names and numbers, and refuse unknown names and contradictions."""
        for value, known, what in (
            (self.ate_form, ATE_FORMS, "ATE form"),
            (self.re_form, RE_FORMS, "RE form"),
            (self.align_with, ALIGN_WITH, "alignment"),
            (self.apply, APPLY, "part of the alignment"),
            (self.nees_form, NEES_FORMS, "NEES form"),
            (self.align_weights, ALIGN_WEIGHTS, "alignment weighting"),
        ):
            require_one_of(value, known, what)
        converted: dict[str, object] = {
            "gauge": gauge_for(self.gauge, self.modality, Gauge.SE3),
            "association": _named(AssociationRule, self.association),
            "lengths": _lengths(self.lengths),
            "selection": _named(Selection, self.selection),
            "lever_m": _vector(self.lever_m),
        }
        for field, stored in converted.items():
            object.__setattr__(self, field, stored)
        self._require_sense()

    @property
    def is_of_a_program(self) -> bool:
        """Whether it reproduces another program, including misleading numbers."""
        return self.name in _OF_PROGRAMS

    @property
    def is_upright(self) -> bool:
        """Whether trajectories are converted to frames with z up before the evaluation.

        Alignments about gravity need it, and likelihoods, which use the tilt of any alignment.
        """
        return self.gauge.yaw_only or self.association.method == "continuous"

    def _require_sense(self) -> None:
        """Refuse values out of range and settings that exclude one another."""
        states: object = self.align_states
        if states is not None and not (isinstance(states, (int, np.integer)) and states >= 1):
            raise SettingsError(f"align states must be all (None) or at least 1, not {states!r}")
        if self.align_with == "poses" and (states == 1 or self.gauge.minimum_states == 1):
            why = (
                "the first state is always aligned by its pose"
                if states == 1
                else f"gauge {self.gauge.value} has no rotation"
            )
            raise SettingsError(f"align with poses has no effect: {why}; remove it")
        if self.apply == "scale" and not self.gauge.has_scale:
            raise SettingsError(f"gauge {self.gauge.value} has no scale to apply; use sim3")
        for length in self.lengths:
            if length.turns and self.selection.compares_rotations and length.radians > np.pi:
                raise SettingsError(
                    f"two orientations never differ by {length}; use a length of at most half a "
                    "turn, or consecutive pairs"
                )
        if self.re_form == "fitted" and not self.gauge.yaw_only:
            raise SettingsError(
                f"RE form fitted needs gauge yaw, not {self.gauge.value}; use gauge yaw, or RE "
                "form gauge"
            )
        if self.association.method == "continuous" and self.gauge is Gauge.PLANAR:
            raise SettingsError(
                "gauge planar is not supported with association continuous; use gauge yaw, or "
                "association linear"
            )
        by_points = self.score is not None or self.recall is not None
        if by_points and self.association.method in _BETWEEN:
            raise SettingsError(
                "a score or recall needs pairs at the groundtruth's own points, not association "
                f"{self.association.method}; use groundtruth-stamps, nearest or evo"
            )
        if self.lever_m is not None and self.gauge.has_scale:
            raise SettingsError(
                "the lever arm of the protocol is in metres, and gauge sim3 has a free scale; "
                "use se3 or yaw"
            )


_HILTI_TIP_M = (0.059, -0.00855, 0.1964)


PROTOCOLS: dict[str, Protocol] = {
    "default": Protocol(),
    # uzh-rpg/rpg_trajectory_evaluation at 8c8ceec: the behaviour of its code, not of its paper.
    "rpg": Protocol(
        name="rpg",
        association=AssociationRule("rpg", max_time_difference_s=0.02),
        in_order=False,
        re_form="euler",
        lengths=tuple(Length(percent, "%") for percent in (10, 20, 30, 40, 50)),
        selection="toolbox",
    ),
    # evo 1.38: evo_ape; with lengths evo_rpe, which takes a single one.
    "evo": Protocol(
        name="evo",
        association=AssociationRule("evo", max_time_difference_s=0.01),
        in_order=False,
        ate_form="evo",
        re_form="evo",
        lengths=(),
        selection=Selection("evo", pairs="consecutive", path="estimate"),
    ),
    # rpng/open_vins, ov_eval: error_singlerun with alignment posyaw.
    "ov_eval": Protocol(
        name="ov_eval",
        gauge=Gauge.YAW,
        association="nearest",
        re_form="se3",
        nees_form="as_published",
    ),
    # The KITTI odometry devkit: frames pair by number, without an alignment.
    "kitti": Protocol(
        name="kitti",
        gauge=Gauge.NONE,
        association="index",
        in_order=False,
        re_form="matrices",
        lengths=metres(100, 200, 300, 400, 500, 600, 700, 800),
        selection=Selection("first-past", every=10),
    ),
    # The UZH-FPV competitions: the organisers' answer in issue 3 of
    # uzh-rpg/IROS2020-FPV-VIO-Competition. The ranking uses the means of position and rotation.
    "uzh-fpv": Protocol(
        name="uzh-fpv", gauge=Gauge.YAW, re_form="fitted", lengths=metres(40, 60, 80, 100, 120)
    ),
    # Hilti SLAM challenge 2022: surveyed points at the tip of the handheld's pole.
    "hilti-2022": Protocol(
        name="hilti-2022",
        association=AssociationRule("evo", max_time_difference_s=2.0),
        in_order=False,
        lengths=(),
        lever_m=_HILTI_TIP_M,
        score=PointTable((0.01, 0.03, 0.06, 0.1), (10.0, 6.0, 3.0, 1.0)),
    ),
    # Hilti-Research/hilti-slam-challenge-2023 at 9af5e39, evaluation-2023: surveyed points at the
    # tip of the handheld's pole. Points of site 3 count twice there: best score 200.
    "hilti-2023": Protocol(
        name="hilti-2023",
        association=AssociationRule("evo", max_time_difference_s=2.0),
        in_order=False,
        lengths=(),
        lever_m=_HILTI_TIP_M,
        score=PointTable((0.005, 0.01, 0.03, 0.06, 0.1, 0.4), (20.0, 10.0, 6.0, 5.0, 3.0, 1.0)),
    ),
    # LaMAria's control points, horizontal errors. Its own evaluation refines the alignment with
    # reprojection errors of the tags at the points; this protocol uses the positions alone.
    "lamaria": Protocol(
        name="lamaria",
        gauge=Gauge.SIM3,
        association=AT_GROUNDTRUTH,
        lengths=(),
        score=KnotTable(
            (0.0, 0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
            (20.0, 20.0, 18.0, 15.0, 12.0, 8.0, 4.0, 0.0),
            dimensions=2,
        ),
        recall=RecallRule((1.0, 5.0), dimensions=2),
    ),
}
"""Named settings that reproduce published numbers (docs/protocols.md).

Example:
    >>> from dataclasses import replace
    >>> from trajeval_ros import PROTOCOLS, Gauge
    >>> replace(PROTOCOLS["evo"], gauge=Gauge.SIM3).association.method
    'evo'
"""


def protocol_named(name: str) -> Protocol:
    """Return a protocol by name."""
    require_one_of(name, PROTOCOLS, "protocol")
    return PROTOCOLS[name]
