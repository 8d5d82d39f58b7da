"""Which errors an evaluation withholds: `doubts_of` is the one place that decides.

All outputs receive errors without the doubtful ones.
"""

from __future__ import annotations

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.premises import Doubts, Premise
from trajeval_ros.metrics.protocol import Protocol


def doubts_of(
    pairs: Association, alignment: Alignment, protocol: Protocol, up_axis: str = ""
) -> Doubts:
    """Return which premises do not hold for aligned pairs.

    `up_axis`: why the groundtruth's up axis is doubtful (`up_axis_doubt`); empty if it is not.
    """
    reasons: dict[Premise, str] = {}
    if not pairs.have_rotations:
        reasons[Premise.ORIENTATIONS] = pairs.without_orientations
    if protocol.gauge is Gauge.PLANAR:
        reasons[Premise.ROLL_AND_PITCH] = reasons[Premise.HEIGHT] = "gauge planar has two axes"
    elif pairs.has_headings_only:
        reasons[Premise.ROLL_AND_PITCH] = "the estimate has 2-D headings"
    if up_axis:
        reasons[Premise.UP_AXIS] = up_axis
        # Angles of form `euler` are the numbers of the toolbox, not angles about gravity.
        if protocol.re_form != "euler":
            reasons[Premise.RELATIVE_UP_AXIS] = up_axis
    freedom, why = alignment.freedom, alignment.why_withheld(protocol)
    if why:
        reasons[Premise.ALIGNMENT_ROTATION] = why
    if why and freedom is not None and freedom.other_body:
        reasons[Premise.BODY_ROTATION] = freedom.other_body
    if freedom is not None and freedom.moves_positions and not freedom.rot_z:
        reasons[Premise.DIRECTIONS] = freedom.undetermined
    if protocol.re_form != "fitted":
        of_bodies = [reasons.get(p) for p in (Premise.ORIENTATIONS, Premise.BODY_ROTATION)]
        if any(of_bodies):
            reasons[Premise.FIRST_STATES] = of_bodies[0] or of_bodies[1] or ""
    return Doubts(reasons)
