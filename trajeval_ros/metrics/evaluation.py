"""The evaluation of one estimate: associate, align, measure. It follows the tutorial's order."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.numbers import counted, significant, whole_percent
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import flattened
from trajeval_ros.geometry.vertical_axis import up_axis_doubt
from trajeval_ros.metrics.absolute_errors import (
    AbsoluteErrors,
    ErrorVectors,
    absolute_errors,
    error_vectors,
)
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association, associate
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH
from trajeval_ros.metrics.columns import (
    ArrayColumns,
    arrow_table,
    columns_of,
    component_columns,
    pandas_frame,
)
from trajeval_ros.metrics.other_programs import pose_errors
from trajeval_ros.metrics.pair_alignment import align_pairs
from trajeval_ros.metrics.premises import Doubts, Premise
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.relative_evaluation import (
    Drift,
    SubTrajectoryErrors,
    relative_evaluation,
    rmse_text,
)
from trajeval_ros.metrics.score import Recall, Score, point_errors
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.metrics.withholding import doubts_of

if TYPE_CHECKING:
    import pandas
    import pyarrow

    from trajeval_ros.metrics.discontinuities.events import Event
    from trajeval_ros.metrics.discontinuities.parts import RunPart
    from trajeval_ros.metrics.scale_along_run import ScaleAlongRun

ATE_METRICS = tuple(item.name for item in dataclasses.fields(AbsoluteErrors))


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """The result of an evaluation, with everything that the numbers depend on.

    Attributes:
        protocol: The settings.
        groundtruth: All groundtruth states, without invalid ones.
        estimate: All estimated states, without invalid ones, in their own frame.
        association: The pairs; the estimate is in its own frame.
        alignment: From the estimate's frame to the groundtruth's.
        absolute: Errors of every pair.
        ate: Statistics of the absolute errors by metric; None if a metric is not available.
        relative: Relative errors by length; None if they are not available.
        pooled: Statistics of `position_percent` and `rotation_deg_per_m` over the
            sub-trajectories of all lengths in metres, as in the KITTI ranking; None without any.
        doubts: What the withheld errors rely on, with reasons.
        remarks: What is said about the validity of the numbers, added by the pipeline.
        score: Score by the protocol's table of points; None without a table.
        recall: Recall of the groundtruth's points; None without a recall rule.
        events: Discontinuities of both sides, added by the pipeline.
        parts: Parts of the estimate between steps and restarts, with their ATE.

    Example:
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> result = evaluate(flight.groundtruth, flight.estimate)
        >>> result.absolute.position_m.shape == (len(result.association),)
        True
        >>> sorted(result.to_columns("8m"))[:2]
        ['ends', 'position_m']
    """

    protocol: Protocol
    groundtruth: Trajectory
    estimate: Trajectory
    association: Association
    alignment: Alignment
    absolute: AbsoluteErrors
    ate: dict[str, Statistics | None]
    relative: tuple[SubTrajectoryErrors, ...] | None
    pooled: dict[str, Statistics | None]
    doubts: Doubts
    remarks: tuple[Remark, ...]
    score: Score | None = None
    recall: Recall | None = None
    events: tuple[Event, ...] = ()
    parts: tuple[RunPart, ...] = ()

    @cached_property
    def aligned(self) -> Trajectory:
        """The paired estimated states, aligned; computed at the first access."""
        return self.alignment.similarity.trajectory(self.association.estimate)

    @cached_property
    def scale_along_run(self) -> ScaleAlongRun | None:
        """The scale along the run, for gauges with a scale; None if the pairs are too few."""
        if not self.protocol.gauge.has_scale:
            return None
        from trajeval_ros.metrics.scale_along_run import scale_along_run

        sides = self.association.groundtruth.positions, self.association.estimate.positions
        return scale_along_run(*sides, self.alignment.similarity.scale)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentences of the remarks that question numbers, the most severe one first."""
        return tuple(remark.text for remark in self.remarks if remark.level > Level.NOTE)

    @property
    def error_vectors(self) -> ErrorVectors:
        """The errors of the pairs axis by axis, in the world and in the body."""
        return error_vectors(
            self.association.groundtruth,
            self.aligned,
            self.protocol.ate_form,
            rotation=self.absolute.rotation_deg is not None,
        )

    @property
    def withheld(self) -> str:
        """Why the alignment's rotation is not reliable; empty if it is."""
        return self.doubts.reasons.get(Premise.ALIGNMENT_ROTATION, "")

    @property
    def drift(self) -> Drift | None:
        """The drift over the longest sub-trajectories in metres; None if there are none."""
        drifts = [
            Drift(percent, part.length_m)
            for part in self.relative or ()
            if part.length_m is not None and (percent := part.statistics["position_percent"])
        ]
        return max(drifts, key=lambda drift: drift.length_m, default=None)

    @property
    def kitti_ranking(self) -> str:
        """The errors of KITTI's ranking, means over all lengths; "" for other protocols."""
        drift, turning = (self.pooled[name] for name in ("position_percent", "rotation_deg_per_m"))
        if self.protocol.name != "kitti" or self.drift is None or drift is None:
            return ""
        parts = [f"{significant(drift.mean, 4)} %"]
        if turning is not None:
            parts.append(f"{significant(100.0 * turning.mean, 3)} deg/100 m")
        lengths = [part.length_m for part in self.relative or () if part.count and part.length_m]
        span = " to ".join(f"{item:g}" for item in dict.fromkeys((min(lengths), max(lengths))))
        return f"{', '.join(parts)} (KITTI, {span} m)"

    def to_columns(self, length: Length | float | str | None = None) -> ArrayColumns:
        """Return errors as columns of equal lengths.

        Args:
            length: One of the protocol's lengths, for the errors of its K sub-trajectories; None
                for the errors of all N pairs.

        Returns:
            For pairs: `stamps` (N,) (int64 ns, groundtruth's clock), the errors of
            `AbsoluteErrors` (N,), the vectors of `ErrorVectors` (N, 3), `aligned_positions`
            (N, 3), metres, and `aligned_quaternions` (N, 4), xyzw; vectors and poses are in the
            axes of the groundtruth's frame as it was read. For sub-trajectories: `starts` and
            `ends` (indices of pairs) and the errors of `RelativeErrors`. Quantities that are not
            available are left out.

        Raises:
            SettingsError: There are no relative errors of that length.
        """
        if length is None:
            return self._pair_columns()
        requested = Length.of(length)
        for part in self.relative or ():
            if part.length == requested:
                return columns_of(part.errors)
        known = ", ".join(str(part.length) for part in self.relative or ()) or "none"
        raise SettingsError(f"no relative errors of {requested}; available: {known}")

    def _pair_columns(self) -> ArrayColumns:
        aligned, vectors = self.aligned, columns_of(self.error_vectors)
        z_up = self.groundtruth.up.applied
        if not np.array_equal(z_up, np.eye(3)):
            back = Similarity(z_up.T, np.zeros(3))
            aligned = back.trajectory(aligned)
            for name in ("position_world_m", "rotation_world_deg"):
                if name in vectors:
                    vectors[name] = back.vectors(vectors[name])
        columns = {
            "stamps": self.association.estimate.stamps,
            **columns_of(self.absolute),
            **vectors,
            "aligned_positions": aligned.positions,
        }
        if aligned.quaternions is not None:
            columns["aligned_quaternions"] = aligned.quaternions
        return columns

    def _table(self, length: Length | float | str | None) -> ArrayColumns:
        """Return columns of shape (N,); those of pairs are the columns of errors.parquet."""
        columns = self.to_columns(length)
        if length is not None:
            return columns
        named = np.full(len(self.association), self.estimate.name)
        return {"estimate": named, **component_columns(columns)}

    def to_arrow(self, length: Length | float | str | None = None) -> pyarrow.Table:
        """Return an Arrow table; that of pairs has the columns of errors.parquet.

        Raises:
            InputError: pyarrow is not installed.
        """
        return arrow_table(self._table(length))

    def to_pandas(self, length: Length | float | str | None = None) -> pandas.DataFrame:
        """Return a pandas data frame; that of pairs has the columns of errors.parquet.

        Raises:
            InputError: pandas is not installed.
        """
        return pandas_frame(self._table(length))

    def __repr__(self) -> str:
        """Return a summary of the errors in a few lines, without arrays."""
        pairs = self.association
        lines = [
            f"<Evaluation of {self.estimate.name or 'unnamed'}: gauge "
            f"{self.protocol.gauge.value}, {counted(len(pairs), 'pair')}, "
            f"{whole_percent(pairs.groundtruth_coverage)} of groundtruth",
            f"  ATE: {rmse_text(self.ate)}",
            *(f"  RE {part.length}: {rmse_text(part.statistics)}" for part in self.relative or ()),
        ]
        if self.warnings:
            lines.append(f"  warnings: {len(self.warnings)}")
        return "\n".join(lines) + ">"

    def _repr_html_(self) -> str:
        """Return the statistics as a table, for notebooks."""
        from trajeval_ros.formatting.text_tables import html_table

        names = ("rmse", "mean", "median", "std", "max", "count")
        groups = [("ATE", self.ate)]
        groups += [(f"RE {part.length}", part.statistics) for part in self.relative or ()]
        rows = [
            (kind, metric, *(f"{getattr(values, name):.4g}" for name in names))
            for kind, statistics in groups
            for metric, values in statistics.items()
            if values is not None
        ]
        caption = (
            f"{self.estimate.name or 'unnamed'}: gauge {self.protocol.gauge.value}, "
            f"{counted(len(self.association), 'pair')}"
        )
        return html_table(caption, ("", "error", *names), rows)


def evaluate(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol | None = None
) -> Evaluation:
    """Evaluate an estimated trajectory against groundtruth.

    `estimate`: states in their own frame. `protocol`: the settings; None for the default protocol.
    """
    protocol = protocol or Protocol()
    if protocol.in_order:
        groundtruth, estimate = groundtruth.in_order(), estimate.in_order()
    if protocol.lever_m is not None:
        # Surveyed points have no orientation, also if their file has a constant one.
        groundtruth = dataclasses.replace(groundtruth, quaternions=None)
    if protocol.gauge is Gauge.PLANAR:
        groundtruth = on_plane(groundtruth)
    rule = protocol.association.for_kind(groundtruth.kind)
    if rule.method == AT_GROUNDTRUTH and protocol.lever_m is not None:
        # The lever arm depends on the orientation at the groundtruth's timestamp.
        pairs = associate(groundtruth, estimate, rule)
        same_point = of_same_point(pairs.estimate, protocol)
        pairs = dataclasses.replace(pairs, estimate=same_point)
        estimate = of_same_point(estimate, protocol)
    else:
        estimate = of_same_point(estimate, protocol)
        pairs = associate(groundtruth, estimate, rule)
    return evaluate_pairs(pairs, groundtruth, estimate, protocol)


def of_same_point(estimate: Trajectory, protocol: Protocol) -> Trajectory:
    """Return the estimate of the groundtruth's point, projected on the plane for gauge planar.

    The lever arm is applied before the projection, since roll and pitch move the point sideways.
    """
    if protocol.lever_m is not None:
        estimate = HandEye.of(None, np.array(protocol.lever_m)).of_marker(estimate, 1.0)
    return on_plane(estimate) if protocol.gauge is Gauge.PLANAR else estimate


def _for_positions(protocol: Protocol) -> Protocol:
    """Return the protocol for pairs without orientations.

    Lengths are measured along the estimate, because noise lengthens the path through sparse fixes.
    """
    if protocol.re_form != "gauge" or not protocol.gauge.yaw_only:
        return protocol
    selection = dataclasses.replace(protocol.selection, path="estimate")
    return dataclasses.replace(protocol, re_form="fitted", selection=selection)


def evaluate_pairs(
    pairs: Association, groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol
) -> Evaluation:
    """Evaluate pairs by a protocol: align them and compute errors and statistics.

    `groundtruth` and `estimate` are all states, the estimate's in its own frame.
    """
    if not pairs.have_rotations:
        protocol = _for_positions(protocol)
    alignment = align_pairs(pairs, protocol)
    # With a doubtful up axis, alignments about gravity are refused.
    up_axis = "" if protocol.gauge.yaw_only else up_axis_doubt(groundtruth)
    doubts = doubts_of(pairs, alignment, protocol, up_axis)
    why = doubts.about(AbsoluteErrors, "rotation_deg")
    if protocol.ate_form == "tutorial" and why:
        raise InputError(
            f"ATE form tutorial, eq. (23), needs rotation errors, but {why}; use ATE form plain"
        )
    measured = _absolute_errors(pairs, alignment, protocol)
    absolute = doubts.without(measured)
    ate = {metric: statistics_of(getattr(absolute, metric)) for metric in ATE_METRICS}
    if protocol.ate_form == "evo":
        ate |= pose_errors(absolute.position_m, absolute.rotation_deg)
    relative, pooled = relative_evaluation(pairs, groundtruth, alignment, protocol, doubts)
    score, recall = protocol.score, protocol.recall

    def of_points(dimensions: int) -> tuple[Floats, int]:
        return point_errors(pairs, groundtruth, measured, dimensions), len(groundtruth)

    return Evaluation(
        protocol=protocol,
        groundtruth=groundtruth,
        estimate=estimate,
        association=pairs,
        alignment=alignment,
        absolute=absolute,
        ate=ate,
        relative=relative,
        pooled=pooled,
        doubts=doubts,
        remarks=(),
        score=None if score is None else score.score(*of_points(score.dimensions)),
        recall=None if recall is None else recall.recall(*of_points(recall.dimensions)),
    )


def _absolute_errors(
    pairs: Association, alignment: Alignment, protocol: Protocol
) -> AbsoluteErrors:
    """Align and measure block by block, which needs less memory than all aligned states."""
    rotation = not alignment.why_withheld(protocol)
    names: list[str] = []

    def at(rows: Indices) -> tuple[NDArray[Any], ...]:
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        aligned = alignment.similarity.trajectory(pairs.estimate[part])
        errors = absolute_errors(
            pairs.groundtruth[part], aligned, protocol.ate_form, rotation=rotation
        )
        columns = columns_of(errors)
        names[:] = columns
        return tuple(columns.values())

    columns = lie.by_blocks(at, np.arange(len(pairs)))
    return AbsoluteErrors(**dict(zip(names, columns, strict=True)))


def on_plane(trajectory: Trajectory) -> Trajectory:
    """Return the states projected on the xy plane; covariances are kept for the weights."""
    flat = flattened(trajectory, "xy")
    return dataclasses.replace(flat, covariances=trajectory.covariances)
