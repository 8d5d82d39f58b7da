"""Protocols: named bundles of settings, so that a published number can be had again."""

from __future__ import annotations

from dataclasses import dataclass, field

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.association import AssociationRule
from trajeval_ros.metrics.score import PointTable
from trajeval_ros.metrics.sub_trajectories import Length, Selection

ATE_FORMS = ("plain", "tutorial")
RE_FORMS = ("gauge", "se3", "tutorial", "euler", "fitted", "matrices")


def metres(*values: float) -> tuple[Length, ...]:
    """Return lengths in metres."""
    return tuple(Length(value, "m") for value in values)


@dataclass(frozen=True)
class Protocol:
    """All settings of an evaluation. `dataclasses.replace` makes a variant.

    Attributes:
        name: The bundle that it started from.
        gauge: What the alignment may change.
        modality: The sensor set that the gauge was chosen by, if so.
        align_states: Align by the first so many matched states; None for all.
        align_weights: `none`, or `covariance` to weigh states by their own position covariances.
        association: How pairs are made.
        in_order: Sort states by stamp and drop repeated stamps first.
        ate_form: `plain`, or `tutorial` for eq. (23) to the letter.
        re_form: See `errors.relative_errors`.
        lengths: Of sub-trajectories; empty for no relative error.
        selection: How a sub-trajectory's end is chosen.
        lever_m: Where in the estimate's body the point is whose position the groundtruth has;
            None for poses of the body itself.
        score: Points for positions that are right; None for no score.
    """

    name: str = "default"
    gauge: Gauge = Gauge.SE3
    modality: str | None = None
    align_states: int | None = None
    align_weights: str = "none"
    association: AssociationRule = field(default_factory=AssociationRule)
    in_order: bool = True
    ate_form: str = "plain"
    re_form: str = "gauge"
    lengths: tuple[Length, ...] = metres(8, 16, 24, 32, 40)
    selection: Selection = field(default_factory=Selection)
    lever_m: tuple[float, float, float] | None = None
    score: PointTable | None = None

    def __post_init__(self) -> None:
        """Refuse settings that mean nothing."""
        if self.align_states is not None and self.align_states < 1:
            raise SettingsError(f"align states must be all or at least 1, not {self.align_states}")
        for name, value, known in (
            ("ATE form", self.ate_form, ATE_FORMS),
            ("RE form", self.re_form, RE_FORMS),
            ("alignment weighting", self.align_weights, ("none", "covariance")),
        ):
            if value not in known:
                raise SettingsError(f"there is no {name} {value!r}; use one of {', '.join(known)}")
        if self.re_form == "fitted" and not self.gauge.turns_about_gravity_only:
            raise SettingsError(
                "RE form fitted aligns by yaw and position, and gauge "
                f"{self.gauge.value} doesn't: use gauge yaw, or RE form gauge"
            )
        if self.association.method == "continuous" and self.gauge is Gauge.PLANAR:
            raise SettingsError(
                "association continuous is of poses in space, and gauge planar leaves a plane; "
                "use gauge yaw, or association linear"
            )
        if self.score is not None and self.association.method in ("linear", "continuous"):
            raise SettingsError(
                "a score is by the groundtruth's own points, and association "
                f"{self.association.method} takes poses between them; use nearest or evo"
            )
        if self.lever_m is not None and self.gauge.has_scale:
            raise SettingsError(
                "the protocol's lever arm is in metres and gauge sim3 has none; use se3 or yaw"
            )


PROTOCOLS: dict[str, Protocol] = {
    "default": Protocol(),
    # uzh-rpg/rpg_trajectory_evaluation at 8c8ceec: what its code does, not its paper.
    "rpg": Protocol(
        name="rpg",
        association=AssociationRule("rpg", max_time_difference_s=0.02),
        in_order=False,
        re_form="euler",
        lengths=tuple(Length(percent, "%") for percent in (10, 20, 30, 40, 50)),
        selection=Selection("toolbox"),
    ),
    # evo 1.38: evo_ape. Its relative error is of another kind, so none is computed by default.
    "evo": Protocol(
        name="evo",
        association=AssociationRule("evo", max_time_difference_s=0.01),
        in_order=False,
        re_form="se3",
        lengths=(),
    ),
    # The KITTI odometry devkit: frames pair by number, nothing is aligned.
    "kitti": Protocol(
        name="kitti",
        gauge=Gauge.NONE,
        association=AssociationRule("index"),
        in_order=False,
        re_form="matrices",
        lengths=metres(100, 200, 300, 400, 500, 600, 700, 800),
        selection=Selection("first-past", every=10),
    ),
    # The UZH-FPV competitions: the organisers' answer in issue 3 of
    # uzh-rpg/IROS2020-FPV-VIO-Competition. Ranked by the means of position and rotation.
    "uzh-fpv": Protocol(
        name="uzh-fpv",
        gauge=Gauge.YAW,
        re_form="fitted",
        lengths=metres(40, 60, 80, 100, 120),
    ),
    # Hilti-Research/hilti-slam-challenge-2023 at 9af5e39, evaluation-2023: surveyed points under
    # the tip of the handheld's pole. Those of site 3 count twice: best 200.
    "hilti-2023": Protocol(
        name="hilti-2023",
        association=AssociationRule("evo", max_time_difference_s=2.0),
        in_order=False,
        lengths=(),
        lever_m=(0.059, -0.00855, 0.1964),
        score=PointTable((0.005, 0.01, 0.03, 0.06, 0.1, 0.4), (20.0, 10.0, 6.0, 5.0, 3.0, 1.0)),
    ),
}
