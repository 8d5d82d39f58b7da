"""The table of settings: every setting of an evaluation, stated once.

A row gives the options of the verbs, the key in YAML files (the file of a comparison, a protocol),
the parameter of the node, and the entry in the provenance of a result and in the plan of a
comparison. Defaults are stated in the request that a row's target is in, and only there. A new
setting is a row here, a field, and the use of the field.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from trajeval_ros.consistency.covariance_request import FRAMES, IntegrityRequest
from trajeval_ros.continuous_time.samples import MODELS, Noise
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.geometry.geodesy import parse_datum
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UP_AXES
from trajeval_ros.io.requests.setting import (
    ALIGN,
    ALL,
    AUTO,
    AVAILABLE,
    COMPARE,
    CONSISTENCY,
    ERRORS,
    EVALUATE,
    FINISH,
    GNSS,
    INPUT,
    MESSAGE,
    NODE,
    NONE,
    PAIR,
    TRAJECTORY,
    WATCH_FACTORS,
    Setting,
    parse_lever,
    parse_noise,
    parse_recall,
    parse_score,
    parse_up,
)
from trajeval_ros.metrics.as_available import RECEIVED
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, METHODS
from trajeval_ros.metrics.availability import HOLD, MOTIONS
from trajeval_ros.metrics.discontinuities.handling import ON_RESTART
from trajeval_ros.metrics.protocol import (
    ALIGN_WEIGHTS,
    ALIGN_WITH,
    APPLY,
    ATE_FORMS,
    NEES_FORMS,
    PROTOCOLS,
    RE_FORMS,
)
from trajeval_ros.metrics.states_table import parse_states
from trajeval_ros.metrics.sub_trajectories import PAIRS, PATHS, RULES, parse_lengths

if TYPE_CHECKING:
    from trajeval_ros.pipeline.request import Request

FROZEN = "frozen"
_MODALITIES = "; ".join(
    f"{gauge.value}: {', '.join(name for name, its in MODALITIES.items() if its is gauge)}"
    for gauge in Gauge
    if gauge in MODALITIES.values()
)
_GAUGES = tuple(item.value for item in Gauge)


def _aligned_states(request: Request) -> str | int:
    if request.states_table:
        return ",".join(map(str, request.states_table))
    states = request.protocol.align_states
    return ALL if states is None else states


def _time_offset(request: Request) -> str | float:
    return AUTO if request.calibration.offset else request.protocol.association.time_offset_s


def _noise(request: Request) -> list[float] | None:
    if request.is_continuous:
        noise = request.protocol.association.noise
        return [noise.position_m, math.degrees(noise.rotation_rad)]
    noise_of_test = request.covariances.groundtruth_noise
    return None if noise_of_test is None else list(noise_of_test)


def _hand_eye(request: Request) -> str | list[float]:
    known = request.calibration.known
    if known is not None:
        return [*known.rotation_xyzw.tolist(), *known.lever_m.tolist()]
    return AUTO if request.calibration.hand_eye else NONE


def _alert_limit(request: Request) -> list[float] | None:
    limits = request.integrity
    if limits is None:
        return None
    return [item for item in (limits.alert_limit_m, limits.alert_limit_deg) if item is not None]


def _end_of_span(request: Request, end: str) -> str | None:
    """Return the start or the end of the time span; None if it is open."""
    span = request.time_span
    nanoseconds: int | None = getattr(span, f"{end}_ns", None)
    if nanoseconds is None:
        return None
    whole, rest = divmod(nanoseconds, NANOSECONDS)
    return f"{'@' if getattr(span, f'absolute_{end}') else ''}{whole}.{rest:09d}"


def _corrections(request: Request) -> dict[str, Any] | None:
    return None if request.corrections is None else dataclasses.asdict(request.corrections)


_ROWS = (
    # Of a protocol.
    Setting(name="protocol", target="protocol.name", metavar="NAME|FILE.yaml", panel=INPUT,
        verbs=(EVALUATE, COMPARE), is_common=True, choices=tuple(PROTOCOLS),
        help=f"Named set of settings: {', '.join(PROTOCOLS)}, or a YAML file "
        "(docs/protocols.md). Other options override it."),
    Setting(name="modality", target="protocol.modality", panel=ALIGN,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, NODE), is_common=True,
        choices=tuple(MODALITIES),
        help=f"Sensors of the estimator; they determine the gauge. {_MODALITIES}."),
    Setting(name="gauge", target="protocol.gauge", panel=ALIGN,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, NODE), is_common=True, choices=_GAUGES,
        node_default="",
        help=f"Transformation that the alignment fits: {', '.join(_GAUGES)} (default: "
        f"{{default}}, or yaw for GNSS fixes)."),
    Setting(name="align_states", target=("protocol.align_states", "states_table"),
        parse=parse_states, read=_aligned_states, metavar="all|N|LIST", panel=ALIGN,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, NODE),
        help="States used for the alignment: all pairs (default) or the first N. With 1, the "
        "first poses are aligned. In evaluate, a list such as 1,25%,50%,75%,all adds a table "
        "with the ATE of every entry.",
        node_help=f"States used for the alignment: all, the first N, or {FROZEN} (all, until the "
        "alignment is well determined)."),
    Setting(name="align_with", target="protocol.align_with", panel=ALIGN,
        verbs=(EVALUATE, COMPARE, FINISH, TRAJECTORY, NODE), choices=ALIGN_WITH,
        help="Data that determine the rotation of the alignment: {default} (default), or poses "
        "to include orientations, for nearly straight paths."),
    Setting(name="apply", target="protocol.apply", panel=ALIGN, choices=APPLY,
        help="Part of the alignment to apply: {default} (default), or only the scale of gauge "
        "sim3, as evo_ape -s does."),
    Setting(name="align_weights", target="protocol.align_weights", panel=ALIGN, verbs=(EVALUATE,),
        choices=ALIGN_WEIGHTS,
        help="Weights of the alignment: equal (default: {default}), or from the position "
        "covariances of the estimate or of the groundtruth."),
    Setting(name="in_order", kind=bool, target="protocol.in_order", panel=PAIR,
        help="Whether states are sorted by timestamp, and repeated timestamps dropped."),
    Setting(name="association", target="protocol.association.method", panel=PAIR,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, NODE), is_common=True, choices=METHODS,
        node_choices=(AUTO, "linear", AT_GROUNDTRUTH),
        help=f"Pairing method. {AUTO} (default): {AT_GROUNDTRUTH} for points and GNSS fixes, "
        "otherwise linear. linear: interpolate the groundtruth at the estimate's timestamps. "
        f"{AT_GROUNDTRUTH}: interpolate the estimate at the groundtruth's. nearest: pair nearest "
        "timestamps one to one. continuous: model the groundtruth over time, and compute "
        "likelihoods. rpg, evo: as these programs. index: pair rows.",
        node_help="Pairing method: linear interpolates the groundtruth at the estimate's "
        f"timestamps, {AT_GROUNDTRUTH} the estimate at the groundtruth's. {AUTO}: "
        f"{AT_GROUNDTRUTH} for NavSatFix and PointStamped, otherwise linear."),
    Setting(name="max_time_difference", kind=float,
        target="protocol.association.max_time_difference_s", metavar="S", panel=PAIR,
        verbs=(EVALUATE, TRAJECTORY),
        help="Largest time difference of a pair for nearest, in seconds. Default: {default}."),
    Setting(name="max_gap", kind=float, target="protocol.association.max_gap_s", metavar="S",
        panel=PAIR, verbs=(EVALUATE, TRAJECTORY, NODE), range=(0.0, 3600.0),
        help="Longest gap to interpolate across, in seconds. Default: {default}. It also "
        "defines coverage (docs/definitions.md)."),
    Setting(name="time_offset",
        target=("protocol.association.time_offset_s", "calibration.offset"), read=_time_offset,
        metavar="S|auto", panel=PAIR, verbs=(EVALUATE, COMPARE, TRAJECTORY, NODE), is_common=True,
        help="Offset added to the estimate's timestamps, in seconds. auto estimates it and "
        "applies it if it is statistically significant.",
        node_help=f"Offset added to the estimates' timestamps, in seconds, or {AUTO}: estimated "
        "from the first minute, and applied if statistically significant."),
    Setting(name="lever_arm", target="protocol.lever_m", parse=parse_lever, metavar="X,Y,Z",
        panel=GNSS, verbs=(EVALUATE, NODE),
        help="Position of the GNSS antenna or prism in the estimate's body frame, in metres.",
        node_help="Position of the groundtruth's antenna or prism in the estimate's body frame, "
        "in metres, as in 0.4,0.2,1.0. For a lever arm from TF use hand_eye, as in "
        "/tf_static:base_link.gps."),
    Setting(name="continuous_model", target="protocol.association.model", metavar="NAME",
        panel=PAIR, verbs=(EVALUATE,), choices=MODELS,
        help=f"Motion model for association continuous: {', '.join(MODELS)}. Default: "
        f"{{default}}."),
    Setting(name="groundtruth_noise",
        target=("protocol.association.noise", "covariances.groundtruth_noise"), parse=parse_noise,
        read=_noise, metavar="P,R", panel=PAIR, verbs=(EVALUATE, COMPARE, FINISH, NODE),
        help="Standard deviations of the groundtruth: position (m), rotation (deg). For "
        "--covariance and association continuous. Default of the latter: "
        f"{Noise().position_m:g},{math.degrees(Noise().rotation_rad):g}.",
        node_help="Standard deviations of the groundtruth for NEES, in metres and degrees, as "
        "in 0.002,0.1. Empty: zero."),
    Setting(name="lengths", target="protocol.lengths", parse=parse_lengths, metavar="LIST",
        panel=ERRORS, verbs=(EVALUATE, COMPARE, NODE), is_common=True, is_live=True,
        help="Sub-trajectory lengths for the relative error: 8,16,24 (metres), 1s,5s (seconds), "
        "1f,10f (frames), 5deg (of rotation), 10%,20% (of the path) or none. Default: "
        "{default}.",
        node_help="Sub-trajectory lengths of the relative error: 8,16 (metres), 1s,5s "
        "(seconds), 1f,10f (frames), 10%,20% (of the path, only in final results) or none."),
    Setting(name="sub_trajectories", target="protocol.selection.pairs", panel=ERRORS,
        choices=PAIRS,
        help="Sub-trajectories start at every state (default: {default}), or consecutive: at "
        "the end of the previous one."),
    Setting(name="sub_trajectory_rule", target="protocol.selection.rule", panel=ERRORS,
        choices=RULES,
        help="End of a sub-trajectory: nearest state; toolbox, as rpg_trajectory_evaluation; "
        "first-past, as KITTI; or evo (default: {default})."),
    Setting(name="sub_trajectory_step", kind=int, target="protocol.selection.every", panel=ERRORS,
        help="Step between the states at which sub-trajectories start. Default: {default}."),
    Setting(name="sub_trajectory_path", target="protocol.selection.path", panel=ERRORS,
        choices=PATHS,
        help="Side along which lengths are measured. Default: {default}."),
    Setting(name="sub_trajectory_tolerance", kind=float, target="protocol.selection.tolerance",
        panel=ERRORS,
        help="Tolerance of lengths, as a fraction, for rule evo with all sub-trajectories. "
        "Default: {default}."),
    Setting(name="ate_form", target="protocol.ate_form", panel=ERRORS, choices=ATE_FORMS,
        help="Form of the ATE: plain (default): difference of positions; evo: also errors of "
        "whole poses; tutorial: eq. (23), which depends on the choice of the origin."),
    Setting(name="re_form", target="protocol.re_form", panel=ERRORS, choices=RE_FORMS,
        help="Form of the relative error: gauge (default), se3 (relative poses), matrices (as "
        "se3, with KITTI's matrices as stored), tutorial (eq. 26), euler, fitted or evo."),
    Setting(name="score", kind=dict, target="protocol.score", parse=parse_score, panel=ERRORS,
        help="Points per position error: bounds_m or knots_m, points, best and dimensions."),
    Setting(name="recall", kind=dict, target="protocol.recall", parse=parse_recall, panel=ERRORS,
        help="Error bounds within which a groundtruth point is found: bounds_m and "
        "dimensions."),
    Setting(name="nees_form", target="protocol.nees_form", panel=CONSISTENCY, choices=NEES_FORMS,
        help="Form of the NEES: gauge (default), with covariances in the gauge of the "
        "alignment, or as_published."),
    # Of the evaluation of a pair.
    Setting(name="hand_eye",
        target=("calibration.hand_eye", "calibration.known", "calibration.source"), read=_hand_eye,
        metavar="none|auto|SOURCE", panel=PAIR,
        verbs=(EVALUATE, COMPARE, FINISH, TRAJECTORY, NODE), is_common=True,
        help="Pose of the groundtruth's marker in the estimate's body: X,Y,Z,QX,QY,QZ,QW "
        "(metres), a TransformStamped in a YAML file, or a static transform in a bag "
        "(BAG:/tf_static:BODY.MARKER); or auto: estimated, and applied if it is significant.",
        node_help="Pose of the groundtruth's marker in the estimate's body: none; "
        "X,Y,Z,QX,QY,QZ,QW (metres); a YAML file with a TransformStamped; "
        "/tf_static:BODY.MARKER; or auto: estimated from the first "
        "minute, and applied if statistically significant."),
    Setting(name="datum", target="fixes.datum", parse=parse_datum, metavar="LAT,LON,HEIGHT",
        panel=GNSS, verbs=(EVALUATE, NODE),
        help="Origin of the east-north-up frame of GNSS fixes: latitude and longitude in "
        "degrees, and height above the ellipsoid in metres. Default: the first fix that is "
        "used."),
    Setting(name="min_fix_status", kind=int, target="fixes.min_status", metavar="0|1|2",
        panel=GNSS, verbs=(EVALUATE, NODE), range=(0.0, 2.0),
        help="Minimum status of a fix: 0 any fix, 1 satellite-based, 2 ground-based "
        "augmentation. Many drivers use the same status for float and fixed RTK."),
    Setting(name="max_fix_sigma", kind=float, target="fixes.max_sigma_m", metavar="M", panel=GNSS,
        verbs=(EVALUATE, NODE), range=(0.0, 1e6),
        help="Largest horizontal standard deviation of a fix per axis, from its own covariance, "
        "in metres.",
        node_help="Largest horizontal standard deviation of a fix per axis, from its own "
        "covariance, in metres. 0: no limit."),
    Setting(name="fix_correlation", kind=float, target="fixes.correlation_s", metavar="S",
        panel=GNSS, verbs=(EVALUATE, NODE), range=(0.001, 1e6),
        help="Correlation time of the fix errors, in seconds, for the noise-corrected "
        "ATE. Default: {default}."),
    Setting(name="covariance",
        target=("covariances.source", "covariances.joint", "covariances.name"),
        read=lambda request: request.covariances.name or request.covariances.source,
        metavar="SOURCE", panel=CONSISTENCY, verbs=(EVALUATE, COMPARE, FINISH, NODE),
        node_choices=(NONE, MESSAGE),
        help="Consistency test of errors and covariances. Source of the covariances: FILE.npz "
        "with the joint covariance of all poses, message for one covariance per pose in the "
        "messages, or none.",
        node_help="Consistency test of errors and covariances in the estimates' messages: "
        "message, or none. The NEES of the window is published, the NEES of the whole run is in "
        "the results."),
    Setting(name="rotation_covariance_frame", target="covariances.rotation_frame",
        panel=CONSISTENCY, verbs=(EVALUATE, FINISH, NODE), choices=FRAMES,
        help="Axes of rotation covariances in messages: {default} (default), as in ROS, or "
        "body, as in OpenVINS."),
    Setting(name="alert_limit", target=("integrity.alert_limit_m", "integrity.alert_limit_deg"),
        read=_alert_limit, metavar="M|M,DEG", panel=CONSISTENCY, verbs=(EVALUATE, NODE),
        help="Integrity test: largest acceptable position error (horizontal and vertical, m) "
        "and heading error (deg). Errors are compared with the protection levels that the "
        "covariances give at --risk.",
        node_help="Largest acceptable error, for protection levels from the covariances: "
        "metres, and optionally degrees for the heading, as in 0.5,2. Needs covariance "
        "message."),
    Setting(name="risk", kind=float, target="integrity.risk",
        read=lambda request: (request.integrity or IntegrityRequest).risk, metavar="P",
        panel=CONSISTENCY, verbs=(EVALUATE, NODE), range=(1e-12, 0.5),
        help="Probability that an error exceeds its protection level. Default: {default}."),
    Setting(name="watch_factor", kind=float, target="watch_factor", metavar="K",
        panel=CONSISTENCY, verbs=(EVALUATE,), is_of_one_run=True, range=WATCH_FACTORS,
        help="With --alert-limit: errors of `trajeval watch` with this factor on its limits count "
        "as alerts in the time to alert."),
    Setting(name="as_available", target="available.motion",
        metavar=f"[{'|'.join(MOTIONS)}]", value_if_alone=HOLD, panel=AVAILABLE,
        verbs=(EVALUATE, COMPARE, FINISH, NODE),
        choices=(NONE, *MOTIONS),
        help="Error of the newest pose that was received, at 100 Hz (docs/as_available.md). For "
        "at most 0.5 s it is predicted by hold (without a value), constant (twist between the "
        "newest two poses) or twist (of the message). Default: none."),
    Setting(name="deadline", kind=float, target="available.deadline_s", metavar="S",
        panel=AVAILABLE, verbs=(EVALUATE, FINISH), range=(0.001, 3600.0),
        help="Largest age of a pose in time, in seconds. Default: {default}."),
    Setting(name="received", target="available.received",
        panel=AVAILABLE, verbs=(EVALUATE,), choices=RECEIVED,
        help="Receive times of a bag: log times of the recorder, or publish times "
        "without transport. auto (default): publish times where they differ."),
    Setting(name="receive_clock", target="available.receive_clock",
        metavar="S|fastest:S", panel=AVAILABLE, verbs=(EVALUATE,),
        help="Correction of the receiver's clock: seconds that are added to receive times, or the "
        "latency of the fastest message, as in fastest:0.005. Default: {default}."),
    Setting(name="up", target="up", parse=parse_up, metavar="AXIS|AXIS,AXIS", panel=INPUT,
        verbs=(EVALUATE, COMPARE, FINISH, NODE),
        help=f"Vertical axis ({', '.join(UP_AXES)}) of all frames, or of the groundtruth and of "
        "the estimates, as in --up=-y,z. Default: -y for KITTI matrices and optical frames, "
        "otherwise z. It defines gauges yaw and planar, and the yaw and tilt errors.",
        node_help=f"Vertical axis ({', '.join(UP_AXES)}) of all frames, or of the groundtruth "
        "and of the estimates, as in -y,z. Empty: -y for frames named *_optical and "
        "*_optical_frame, otherwise z. YAML needs quotes for 'y'."),
    Setting(name="start", target=("time_span.start_ns", "time_span.absolute_start"),
        read=lambda request: _end_of_span(request, "start"), metavar="S|@STAMP", panel=INPUT,
        verbs=(EVALUATE, COMPARE, TRAJECTORY),
        help="Start of the evaluated time span: seconds after the first timestamp of the "
        "groundtruth (or reference), as in 10.5, or a timestamp, as in @1403636580.5."),
    Setting(name="end", target=("time_span.end_ns", "time_span.absolute_end"),
        read=lambda request: _end_of_span(request, "end"), metavar="S|@STAMP|+S", panel=INPUT,
        verbs=(EVALUATE, COMPARE, TRAJECTORY),
        help="End of the evaluated time span: as --start, or +30 for 30 s after the start."),
    Setting(name="on_restart", target="discontinuities.on_restart", panel=ERRORS,
        verbs=(EVALUATE,), choices=ON_RESTART, is_of_one_run=True,
        help="At restarts and steps of the estimate: whole (default) aligns all pairs at once. "
        "split also aligns the parts separately, and states their ATE and the ATE of all "
        "parts together."),
    Setting(name="drop_groundtruth_outliers", kind=bool, panel=INPUT, verbs=(EVALUATE, COMPARE),
        target="discontinuities.drop_groundtruth_outliers",
        help="Drops groundtruth poses that leave the path of their neighbours for a time, and "
        "that the estimate contradicts; their number is stated."),
    Setting(name="corrections", kind=dict, target="corrections", read=_corrections,
        is_of_one_run=True,
        help="Conventions of the inputs that differ from those that were read, in Python "
        "only."),
    Setting(name="correct", target="correct", metavar="CAUSE|suggested", panel=INPUT,
        verbs=(EVALUATE,), is_common=True, is_of_one_run=True,
        help="Mistake to correct if the diagnosis finds it; the errors before and after are "
        "printed. suggested corrects the most severe one, up to 4 times (docs/diagnosis.md)."),
)  # fmt: skip
SETTINGS: dict[str, Setting] = {row.name: row for row in _ROWS}


def settings_of(request: Request) -> dict[str, Any]:
    """Return the values of all settings in a request by name, in types of JSON."""
    return {name: setting.of(request) for name, setting in SETTINGS.items()}


def settings_with(request: Request, stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of an evaluated live run by name.

    `stated`: settings of the node; the request overrides them where its values are no defaults.
    """
    settings = settings_of(request)
    for name, setting in SETTINGS.items():
        is_of_protocol = all(target.startswith("protocol.") for target in setting.targets)
        if name in stated and not is_of_protocol and settings[name] == setting.default:
            settings[name] = stated[name]
    if stated.get("time_offset") == AUTO:
        settings["time_offset"] = AUTO
    return settings


def settings_of_many_runs() -> dict[str, Setting]:
    """Return the settings that a comparison accepts, by name."""
    return {name: setting for name, setting in SETTINGS.items() if not setting.is_of_one_run}
