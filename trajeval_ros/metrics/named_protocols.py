"""Named protocols that reproduce published numbers."""

from __future__ import annotations

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AssociationRule
from trajeval_ros.metrics.protocol import Protocol, metres
from trajeval_ros.metrics.score import KnotTable, PointTable, RecallRule
from trajeval_ros.metrics.sub_trajectories import Length, Selection

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
