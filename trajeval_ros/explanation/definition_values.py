"""The values of all definitions for one groundtruth and one estimate.

Associations and alignments are computed once. Equal sets of pairs have one value under all names.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from trajeval_ros.exceptions import InputError, NoMatchError, TrajevalError
from trajeval_ros.explanation.definition import (
    ABSOLUTE,
    ALIGNMENTS,
    ASSOCIATIONS,
    EXCHANGED,
    FAMILIES,
    KITTI,
    LAST,
    PER_AXIS,
    PER_PATH,
    POOLED,
    Definition,
    protocol_of,
)
from trajeval_ros.geometry.frame_axes import upright
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import require_up_axis
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association, associate
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.premises import Doubts
from trajeval_ros.metrics.protocol import PROTOCOLS
from trajeval_ros.metrics.relative_evaluation import relative_evaluation


class Paired(NamedTuple):
    """Pairs, the associations that give them and whether they keep matrices, and both sides."""

    names: dict[str, bool]
    pairs: Association
    groundtruth: Trajectory
    estimate: Trajectory


# A definition without its association, its value, and whether protocols of this package withhold
# the value.
Value = tuple[tuple[str, ...], float, bool]


def values_of(
    groundtruth: Trajectory, estimate: Trajectory
) -> tuple[dict[Definition, int], list[float]]:
    """Return the places of all definitions in a list of values, and these values.

    Raises:
        InputError: No association pairs any states, or the groundtruth has GNSS fixes.
    """
    places: dict[Definition, int] = {}
    values: list[float] = []
    for paired in _associations(groundtruth, estimate):
        first, *_ = paired.names.values()
        for rest, value, withheld in _values_of_pairs(paired):
            for name, has_matrices in paired.names.items():
                definition = Definition(name, *rest)
                # Interpolated rotations are not the inexact matrices of KITTI's files.
                is_same = has_matrices is first or definition.family != KITTI
                if is_same and definition.is_searched(withheld):
                    places[definition] = len(values)
            values.append(value)
    return places, values


def _associations(groundtruth: Trajectory, estimate: Trajectory) -> Iterable[Paired]:
    """Return the distinct sets of pairs."""
    if groundtruth.reading.fixes is not None:
        raise InputError("the groundtruth has GNSS fixes; explain needs poses, as of text files")
    paired: dict[tuple[object, ...], Paired] = {}
    both, refusal = (groundtruth.reading, estimate.reading), None
    stamped = all(item.stamped for item in both)
    framed = all(item.frame_numbers is not None or not item.stamped for item in both)
    for name, (protocol, rule, _) in ASSOCIATIONS.items():
        if not (framed if rule.method == "index" else stamped):
            continue
        sides = (estimate, groundtruth) if name == EXCHANGED else (groundtruth, estimate)
        if PROTOCOLS[protocol].in_order:
            sides = sides[0].in_order(), sides[1].in_order()
        try:
            pairs = associate(*sides, rule)
        except NoMatchError as error:
            refusal = error
            continue
        columns = pairs.groundtruth.positions.tobytes(), pairs.estimate.positions.tobytes()
        key = (name == EXCHANGED, sides[0].path_length_m, *columns)
        read = pairs.groundtruth.reading, pairs.estimate.reading
        has_matrices = all(item.matrices is not None for item in read)
        paired.setdefault(key, Paired({}, pairs, *sides)).names[name] = has_matrices
    if not paired and refusal is not None:
        raise refusal
    return paired.values()


def _values_of_pairs(paired: Paired) -> Iterator[Value]:
    aligned: dict[str, Alignment] = {}
    for name in ("sim3",) if EXCHANGED in paired.names else ALIGNMENTS:
        if (ALIGNMENTS[name].states or 0) < len(paired.pairs):
            try:
                evaluation = _evaluated(paired, name, aligned)
            except TrajevalError:  # the states do not determine this alignment
                continue
            aligned[name] = evaluation.alignment
            yield from _absolute(evaluation, name, paired.groundtruth.path_length_m)
    for family, searched in FAMILIES.items():
        if not set(searched.associations).isdisjoint(paired.names):
            for name in sorted(aligned.keys() & {"se3", "sim3"}):
                yield from _relative(paired, aligned[name], name, family)


def _evaluated(paired: Paired, name: str, before: dict[str, Alignment]) -> Evaluation:
    """Evaluate the pairs with an alignment; `before` has those of the names before it."""
    protocol = protocol_of(next(iter(paired.names)), name)
    aligning, pairs = ALIGNMENTS[name], paired.pairs
    groundtruth, estimate = pairs.groundtruth, pairs.estimate
    if protocol.is_upright:
        require_up_axis(groundtruth, estimate, protocol.gauge)
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    if aligning.scaled_by:
        scale = before[aligning.scaled_by].similarity.scale
        estimate = Similarity(np.eye(3), np.zeros(3), scale).trajectory(estimate)
    elif name != "sim3" and (aligning.has_scale or aligning.gauge is Gauge.TRANSLATION):
        # Rotation errors are those of se3 and none, and take most of the time. Whether horizontal
        # errors of sim3 are determined depends on the orientations.
        groundtruth = dataclasses.replace(groundtruth, quaternions=None)
        estimate = dataclasses.replace(estimate, quaternions=None)
    pairs = dataclasses.replace(pairs, groundtruth=groundtruth, estimate=estimate)
    # The command of a definition gives the up axis, so that no number is withheld for it.
    groundtruth = dataclasses.replace(groundtruth, up=UpAxis(groundtruth.up.name))
    return evaluate_pairs(pairs, groundtruth, estimate, protocol)


def _absolute(evaluation: Evaluation, name: str, path_m: float) -> Iterator[Value]:
    withheld = bool(evaluation.alignment.why_rotation_withheld)
    last_m = float(evaluation.absolute.position_m[-1])
    factors = {PER_AXIS: math.sqrt(1.0 / 3.0), PER_PATH: 100.0 / path_m}
    for (metric, form), (statistics, alignments, _) in ABSOLUTE.items():
        errors = evaluation.ate.get(metric)
        for statistic in statistics if errors and name in alignments else ():
            value = last_m if statistic == LAST else getattr(errors, statistic)
            rest = (name, metric, statistic, form, "", "")
            yield rest, factors.get(form, 1.0) * value, withheld and not metric.endswith("_m")


def _relative(paired: Paired, alignment: Alignment, name: str, family: str) -> Iterator[Value]:
    searched = FAMILIES[family]
    protocol = protocol_of(searched.associations[0], name, family)
    try:
        parts, pooled = relative_evaluation(
            paired.pairs, paired.groundtruth, alignment, protocol, Doubts()
        )
    except TrajevalError:  # pairs that are not in order have no lengths in seconds
        return
    drift = dict.fromkeys(pooled, searched.pooled)
    by_length = [(str(part.length), part.statistics, searched.metrics) for part in parts or ()]
    for length, statistics, names in (*by_length, (POOLED, pooled, drift)):
        for metric, chosen in names.items():
            # Rotation errors do not depend on the scale.
            values = statistics[metric] if name == "se3" or "position" in metric else None
            for statistic in chosen if values else ():
                rest = (name, metric, statistic, "", family, length)
                yield rest, getattr(values, statistic), False
