"""The whole evaluation of one estimate: associate, align, measure. Reads like the tutorial."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.numbers import counted, percent
from trajeval_ros.formatting.text_tables import html_table
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.flattening import flattened
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import Alignment, align, align_first
from trajeval_ros.metrics.association import AT_GROUNDTRUTH, Association, associate
from trajeval_ros.metrics.columns import arrow_table, pandas_frame
from trajeval_ros.metrics.drift import Drift
from trajeval_ros.metrics.errors import AbsoluteErrors, RelativeErrors, absolute_errors
from trajeval_ros.metrics.pose_relations import pose_errors
from trajeval_ros.metrics.protocol import GROUNDTRUTH_WEIGHTS, Protocol
from trajeval_ros.metrics.relative_evaluation import (
    SubTrajectoryErrors,
    relative_evaluation,
    rmse_text,
)
from trajeval_ros.metrics.score import Recall, Score
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.metrics.weighted_alignment import align_by_groundtruth, align_weighted

if TYPE_CHECKING:
    import pandas
    import pyarrow


ATE_METRICS = tuple(each.name for each in dataclasses.fields(AbsoluteErrors))


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """How wrong an estimate is, with everything that the numbers depend on.

    Attributes:
        protocol: The settings.
        groundtruth: All groundtruth states, cleaned.
        estimate: All estimated states, cleaned, in their own frame.
        association: The pairs, the estimate's in its own frame.
        alignment: From the estimate's frame to the groundtruth's.
        absolute: Errors pair by pair.
        ate: Their statistics by metric; None where a metric can't be had.
        segments: Relative errors by length; None where they can't be had at all.
        pooled: Statistics of `position_percent` and `rotation_deg_per_m` over the
            sub-trajectories of all lengths in metres, as KITTI ranks by; None without any.
        warnings: What a reader of the numbers must know, one sentence each; the pipeline adds
            them.
        score: By the protocol's points; None if it has none.
        recall: Of the groundtruth's points; None unless the protocol asks for it.

    Example:
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> found = evaluate(flight.groundtruth, flight.estimate)
        >>> found.absolute.position_m.shape == (len(found.association),)
        True
        >>> sorted(found.to_columns("8m"))[:2]
        ['ends', 'position_m']
    """

    protocol: Protocol
    groundtruth: Trajectory
    estimate: Trajectory
    association: Association
    alignment: Alignment
    absolute: AbsoluteErrors
    ate: dict[str, Statistics | None]
    segments: tuple[SubTrajectoryErrors, ...] | None
    pooled: dict[str, Statistics | None]
    warnings: tuple[str, ...]
    score: Score | None = None
    recall: Recall | None = None

    @cached_property
    def aligned(self) -> Trajectory:
        """The paired estimated states, aligned; made when they are first asked for."""
        return self.alignment.similarity.trajectory(self.association.estimate)

    @property
    def withheld(self) -> str:
        """Empty, or why the alignment's rotation and velocity errors mean nothing."""
        return self.alignment.why_withheld(self.protocol)

    @property
    def drift(self) -> Drift | None:
        """The drift over the longest sub-trajectories in metres; None if there are none."""
        known = [
            Drift(percent, each.length_m)
            for each in self.segments or ()
            if each.length_m is not None and (percent := each.statistics["position_percent"])
        ]
        return max(known, key=lambda drift: drift.length_m, default=None)

    def to_columns(self, length: Length | float | str | None = None) -> dict[str, NDArray[Any]]:
        """Return errors as columns of equal lengths.

        Args:
            length: One of the protocol's lengths, for the errors of its K sub-trajectories; None
                for those of all N pairs.

        Returns:
            Of pairs `stamps` (int64 ns, of the groundtruth's clock) and each error that
            `AbsoluteErrors` has; of sub-trajectories `starts` and `ends` (indices of pairs) and
            each error that `RelativeErrors` has.

        Raises:
            SettingsError: No relative errors of that length were computed.
        """
        if length is None:
            return {"stamps": self.association.estimate.stamps, **_columns_of(self.absolute)}
        wanted = Length.of(length)
        for each in self.segments or ():
            if each.length == wanted:
                return _columns_of(each.errors)
        known = ", ".join(str(each.length) for each in self.segments or ()) or "none"
        raise SettingsError(f"no relative errors of {wanted}; available: {known}")

    def to_arrow(self, length: Length | float | str | None = None) -> pyarrow.Table:
        """Return `to_columns` as an Arrow table.

        Raises:
            InputError: pyarrow is not installed.
        """
        return arrow_table(self.to_columns(length))

    def to_pandas(self, length: Length | float | str | None = None) -> pandas.DataFrame:
        """Return `to_columns` as a pandas data frame.

        Raises:
            InputError: pandas is not installed.
        """
        return pandas_frame(self.to_columns(length))

    def __repr__(self) -> str:
        """Return a few lines that say how wrong the estimate is, without the arrays."""
        pairs, segments = self.association, self.segments or ()
        lines = [
            f"<Evaluation of {self.estimate.name or 'unnamed'}: gauge "
            f"{self.protocol.gauge.value}, {counted(len(pairs), 'pair')}, "
            f"{percent(pairs.groundtruth_coverage)} of groundtruth",
            f"  ATE: {rmse_text(self.ate)}",
            *(f"  RE {each.length}: {rmse_text(each.statistics)}" for each in segments),
        ]
        if self.warnings:
            lines.append(f"  warnings: {len(self.warnings)}")
        return "\n".join(lines) + ">"

    def _repr_html_(self) -> str:
        """Return the statistics as a table, for notebooks."""
        names = ("rmse", "mean", "median", "std", "max", "count")
        groups = [("ATE", self.ate)]
        groups += [(f"RE {each.length}", each.statistics) for each in self.segments or ()]
        rows = [
            (kind, metric, *(f"{getattr(found, name):.4g}" for name in names))
            for kind, statistics in groups
            for metric, found in statistics.items()
            if found is not None
        ]
        caption = (
            f"{self.estimate.name or 'unnamed'}: gauge {self.protocol.gauge.value}, "
            f"{counted(len(self.association), 'pair')}"
        )
        return html_table(caption, ("", "error", *names), rows)


def _columns_of(errors: AbsoluteErrors | RelativeErrors) -> dict[str, NDArray[Any]]:
    return {
        field.name: column
        for field in dataclasses.fields(errors)
        if (column := getattr(errors, field.name)) is not None
    }


def evaluate(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol | None = None
) -> Evaluation:
    """Evaluate an estimated trajectory against groundtruth.

    Raises:
        InputError: Trajectories that can't be evaluated; NoMatchError where no stamps match.
        DegenerateGeometryError: Too few states, or no motion, for the gauge's alignment.
    """
    protocol = protocol or Protocol()
    if protocol.in_order:
        groundtruth, estimate = groundtruth.in_order(), estimate.in_order()
    if protocol.lever_m is not None:
        # Surveyed points have no orientation, whatever their file says.
        groundtruth = dataclasses.replace(groundtruth, quaternions=None)
    if protocol.gauge is Gauge.PLANAR:
        groundtruth = _on_plane(groundtruth)
    rule = protocol.association.for_kind(groundtruth.kind)
    if rule.method == AT_GROUNDTRUTH:
        # The lever arm swings with the orientation at the groundtruth's stamp.
        pairs = associate(groundtruth, estimate, rule)
        same_point = _of_same_point(pairs.estimate, protocol)
        pairs = dataclasses.replace(pairs, estimate=same_point)
        estimate = _of_same_point(estimate, protocol)
    else:
        estimate = _of_same_point(estimate, protocol)
        pairs = associate(groundtruth, estimate, rule)
    return evaluate_pairs(pairs, groundtruth, estimate, protocol)


def _of_same_point(estimate: Trajectory, protocol: Protocol) -> Trajectory:
    """Return the estimate of the point that the groundtruth is of, in the plane if that is asked.

    The lever arm comes first, which a tilting body swings to the side.
    """
    if protocol.lever_m is not None:
        estimate = HandEye.of(None, np.array(protocol.lever_m)).of_marker(estimate, 1.0)
    return _on_plane(estimate) if protocol.gauge is Gauge.PLANAR else estimate


def _for_positions(protocol: Protocol) -> Protocol:
    """Return a protocol whose relative errors need no orientation.

    Ends are chosen along the estimate: noise makes the path through sparse fixes longer.
    """
    if protocol.re_form != "gauge" or not protocol.gauge.turns_about_gravity_only:
        return protocol
    selection = dataclasses.replace(protocol.selection, path="estimate")
    return dataclasses.replace(protocol, re_form="fitted", selection=selection)


def evaluate_pairs(
    pairs: Association, groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol
) -> Evaluation:
    """Evaluate what has been associated: align, measure, count.

    Args:
        pairs: States paired by the protocol's rule.
        groundtruth: All states that they were chosen from.
        estimate: Likewise, in their own frame.
        protocol: The settings.

    Raises:
        InputError: The pairs lack what the protocol needs.
        DegenerateGeometryError: Too few states, or no motion, for the gauge's alignment.
    """
    if not pairs.have_rotations:
        protocol = _for_positions(protocol)
    alignment = align_pairs(pairs, protocol)
    withheld = alignment.why_withheld(protocol)
    if protocol.ate_form == "tutorial" and (withheld or not pairs.have_rotations):
        why = withheld or "one side has no orientations"
        raise InputError(
            f"ATE form tutorial, eq. (23), needs rotation errors, but {why}; use ATE form plain"
        )
    absolute = _absolute_errors(pairs, alignment, protocol)
    if protocol.gauge is Gauge.PLANAR:
        absolute = dataclasses.replace(absolute, tilt_deg=None, vertical_m=None)
    ate = {metric: statistics_of(getattr(absolute, metric)) for metric in ATE_METRICS}
    if protocol.ate_form == "evo":
        ate |= pose_errors(absolute.position_m, absolute.rotation_deg)
    segments, pooled = relative_evaluation(pairs, groundtruth, alignment, protocol)
    return Evaluation(
        protocol=protocol,
        groundtruth=groundtruth,
        estimate=estimate,
        association=pairs,
        alignment=alignment,
        absolute=absolute,
        ate=ate,
        segments=segments,
        pooled=pooled,
        warnings=(),
        score=None
        if protocol.score is None
        else protocol.score.score(
            _point_errors(pairs, groundtruth, absolute, protocol.score.dimensions),
            len(groundtruth),
        ),
        recall=None
        if protocol.recall is None
        else protocol.recall.recall(
            _point_errors(pairs, groundtruth, absolute, protocol.recall.dimensions),
            len(groundtruth),
        ),
    )


def _absolute_errors(
    pairs: Association, alignment: Alignment, protocol: Protocol
) -> AbsoluteErrors:
    """Align and measure block by block: all aligned states at once are seldom needed."""
    rotation = not alignment.why_withheld(protocol)
    names: list[str] = []

    def at(rows: Indices) -> tuple[NDArray[Any], ...]:
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        aligned = alignment.similarity.trajectory(pairs.estimate[part])
        errors = absolute_errors(
            pairs.groundtruth[part], aligned, protocol.ate_form, rotation=rotation
        )
        columns = _columns_of(errors)
        names[:] = columns
        return tuple(columns.values())

    columns = lie.by_blocks(at, np.arange(len(pairs)))
    return AbsoluteErrors(**dict(zip(names, columns, strict=True)))


def _point_errors(
    pairs: Association, groundtruth: Trajectory, absolute: AbsoluteErrors, dimensions: int
) -> Floats:
    """Return the error of each groundtruth state that is in a pair, metres."""
    errors = absolute.horizontal_m if dimensions == 2 else absolute.position_m
    assert errors is not None
    return errors[_nearest_of_each_point(pairs, groundtruth)]


def _nearest_of_each_point(pairs: Association, groundtruth: Trajectory) -> NDArray[np.int64]:
    """Return, for each groundtruth state that is in a pair, the pair that is closest in time."""
    points = pairs.groundtruth_rows
    assert points is not None
    apart = np.abs(groundtruth.stamps[points] - pairs.estimate.stamps)
    closest_first = np.lexsort((apart, points))
    return closest_first[np.unique(points[closest_first], return_index=True)[1]]


def align_pairs(pairs: Association, protocol: Protocol) -> Alignment:
    """Return what the protocol applies of the alignment by all matched states, or the first few.

    Tutorial, Table I.

    Raises:
        InputError: The states lack what the protocol's weights need.
        DegenerateGeometryError: Too few states, or no motion, for the gauge.
    """
    alignment = _alignment_of(pairs, protocol)
    return alignment.scale_alone if protocol.apply == "scale" else alignment


def _alignment_of(pairs: Association, protocol: Protocol) -> Alignment:
    truth, estimate = pairs.groundtruth, pairs.estimate
    if protocol.align_states == 1:
        return align_first(
            protocol.gauge,
            truth.positions[0],
            None if truth.quaternions is None else truth.quaternions[0],
            estimate.positions[0],
            None if estimate.quaternions is None else estimate.quaternions[0],
        )
    first, way = slice(protocol.align_states), protocol.align_with
    p, q = truth.positions[first], estimate.positions[first]
    orientations = None
    if truth.quaternions is not None and estimate.quaternions is not None:
        orientations = truth.quaternions[first], estimate.quaternions[first]
    elif way == "poses":
        raise InputError(
            "align with poses needs orientations on both sides, and one side has none; use "
            "align with positions"
        )
    if protocol.align_weights == "covariance":
        covariances = _known_covariances(estimate, "the estimate")[first]
        return align_weighted(protocol.gauge, p, q, covariances, orientations, way)
    if protocol.align_weights == GROUNDTRUTH_WEIGHTS:
        axes = slice(2 if protocol.gauge is Gauge.PLANAR else 3)
        covariances = _known_covariances(truth, "the groundtruth")[first, axes, axes]
        return align_by_groundtruth(protocol.gauge, p, q, covariances, orientations, way)
    return align(protocol.gauge, p, q, orientations=orientations, align_with=way)


def _known_covariances(side: Trajectory, who: str) -> Floats:
    covariances = side.covariances
    if covariances is not None:
        variances = np.diagonal(covariances[:, :3, :3], axis1=1, axis2=2)
        if (np.isfinite(variances) & (variances > 0.0)).all():
            return covariances
    raise InputError(
        f"{side.name or who} has pairs without a position covariance, which the weighting of the "
        "alignment needs; use alignment weighting none"
    )


def _on_plane(trajectory: Trajectory) -> Trajectory:
    """Return the states projected on the xy plane; their covariances, for weights, as they are."""
    flat = flattened(trajectory, "xy")
    return dataclasses.replace(flat, covariances=trajectory.covariances)
