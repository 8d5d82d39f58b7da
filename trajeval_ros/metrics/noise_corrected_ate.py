"""The estimate's own error: the ATE without the contribution of GNSS noise, and jumps of fixes.

Let e be the estimate's errors, n the noise of the fixes with covariance C, and P the projection
that an alignment applies to both. Then r = P (e + n) and E|r|^2 = |Pe|^2 + tr(PC). Errors of fixes
are correlated over minutes: hundreds of fixes can be worth a few independent ones.

In a jump, the error between estimate and fixes steps away and back. Multipath causes jumps without
an increase of the fix's covariance; an estimate can cause them, too. Flagged pairs stay in the
evaluation and are left out of an additional result only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.fixes import COVARIANCE_APPROXIMATED
from trajeval_ros.geometry.gauge import Gauge, orbit_basis
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.pair_alignment import align_pairs

# White share of a fix's variance; the rest is correlated over time.
_WHITE = 0.2
_Z_95 = 1.959963984540054
_MOST_FIXES = 2000  # the cost is quadratic
_FEWEST_FIXES = 10
# A larger share of flagged fixes is multipath that the covariances omit; clean RTK has 0.3 %.
_MULTIPATH = 0.01


@dataclass(frozen=True)
class NoiseCorrectedAte:
    """The position error of an estimate without the noise of the paired fixes."""

    correlation_s: float  # correlation time of the fix errors, seconds
    ate_m: float  # RMSE without the noise of the fixes, jumps of fixes excluded
    interval_m: tuple[float, float]
    with_jumps_m: float  # RMSE without the noise of the fixes, jumps included
    noise_rms_m: float  # contribution of the noise to the ATE (their squares add)
    effective_fixes: float  # number of independent fixes with the same information
    fixes: int  # number of fixes in use
    jumps: int  # number of fixes left out, because the errors of all estimates jump there
    single_jumps: int  # number of fixes where this estimate's error jumps and not all do; in use
    by_guess: bool  # whether the covariances of the fixes are the driver's approximation
    resolved: bool  # whether the error is known better than as an upper bound


@dataclass(frozen=True)
class Debiased:
    """An RMSE without the noise of the reference."""

    ate_m: float  # the RMSE; 0 if the noise explains all of the residuals
    interval_m: tuple[float, float]  # its 95 % interval
    noise_rms_m: float  # contribution of the noise to the ATE (their squares add)
    effective: float  # number of independent samples with the same information


def debiased(
    errors: Floats, aligned: Floats, covariances: Floats, correlations: Floats, gauge: Gauge
) -> Debiased:
    """Return the RMSE after an unweighted alignment, without the groundtruth's noise.

    Errors (groundtruth minus aligned estimate) and aligned positions are (N, 3), metres.
    Covariances of the groundtruth are (N, 3, 3), m^2, zero perpendicular to a plane;
    `correlations` (N, N) are those of its noise between states.
    """
    count = len(errors)
    values, axes = np.linalg.eigh(covariances)
    halves = (axes * np.sqrt(np.maximum(values, 0.0))[:, None]) @ axes.swapaxes(1, 2)
    basis = np.linalg.qr(_tangent(gauge, aligned))[0]

    def times_covariance(columns: Floats) -> Floats:
        """Return C X for X (3N, m), C_ij = S_i^(1/2) K_ij S_j^(1/2)."""
        wide = halves @ columns.reshape(count, 3, -1)
        mixed = (correlations @ wide.reshape(count, -1)).reshape(wide.shape)
        product: Floats = (halves @ mixed).reshape(columns.shape)
        return product

    weighted = times_covariance(basis)
    products = covariances.reshape(count, 9) @ covariances.reshape(count, 9).T
    square = float(np.vdot(correlations**2, products))
    noise = float(np.trace(covariances, axis1=1, axis2=2).sum() - np.vdot(basis, weighted))
    noise_square = (
        square
        - 2.0 * float(np.vdot(weighted, weighted))
        + float(np.square(basis.T @ weighted).sum())
    )
    column = errors.reshape(-1, 1)
    crossed = max(0.0, float(np.vdot(column, times_covariance(column))) - noise_square)
    value = (float(np.vdot(errors, errors)) - noise) / count
    half_width = _Z_95 * np.sqrt(2.0 * max(0.0, noise_square) + 4.0 * crossed) / count
    effective = count * float(products.diagonal().sum()) / square if square else float(count)
    return Debiased(
        ate_m=_root(value),
        interval_m=(_root(value - half_width), _root(value + half_width)),
        noise_rms_m=_root(noise / count),
        effective=effective,
    )


def correlations_of(stamps: Stamps, correlation_s: float) -> Floats:
    """Return the correlation of the noise of fixes between N stamps, (N, N)."""
    seconds = (stamps - stamps[0]) / NANOSECONDS
    apart = np.abs(seconds[:, None] - seconds)
    correlations: Floats = (1.0 - _WHITE) * np.exp(-apart / correlation_s)
    correlations[np.diag_indices(len(stamps))] = 1.0
    return correlations


def noise_corrected_ates(
    evaluations: Sequence[Evaluation], correlation_s: float
) -> list[tuple[NoiseCorrectedAte | None, str]]:
    """Return the noise-corrected ATE of every estimate of one run and "", or None and the reason.

    All evaluations are against the same fixes. A jump in the errors of all estimates is a jump of
    the fixes; otherwise it is the estimate's. The correlation of the fix errors decays to 1/e in
    `correlation_s`.
    """
    flags = [_flagged(evaluation) for evaluation in evaluations]
    paired = [evaluation.association.groundtruth.stamps for evaluation in evaluations]
    blamed = flags[0]
    for flagged, stamps in zip(flags[1:], paired[1:], strict=True):
        blamed = np.intersect1d(blamed, np.union1d(flagged, np.setdiff1d(blamed, stamps)))
    results: list[tuple[NoiseCorrectedAte | None, str]] = []
    for evaluation, flagged in zip(evaluations, flags, strict=True):
        why = _why_not(evaluation)
        if why:
            results.append((None, why))
            continue
        stamps = evaluation.association.groundtruth.stamps
        jumps = np.isin(stamps, np.intersect1d(flagged, blamed))
        single_jumps = len(np.setdiff1d(flagged, blamed))
        results.append((_noise_corrected_ate(evaluation, correlation_s, jumps, single_jumps), ""))
    return results


def _flagged(evaluation: Evaluation) -> Stamps:
    """Return the stamps of the pairs in a jump."""
    groundtruth, aligned = evaluation.association.groundtruth, evaluation.aligned
    errors = groundtruth.up.to_z_up(groundtruth.positions - aligned.positions)
    return groundtruth.stamps[jumps_of(groundtruth.stamps, errors)]


def _why_not(evaluation: Evaluation) -> str:
    """Return why the noise of the fixes cannot be removed; empty if it can."""
    protocol, groundtruth = evaluation.protocol, evaluation.association.groundtruth
    if protocol.align_states is not None or protocol.align_weights != "none":
        return "the alignment does not use all fixes with equal weights"
    fixes = groundtruth.reading.fixes
    if fixes is None or groundtruth.covariances is None:
        return "this association has no covariances of the fixes; use --association auto"
    unknown = int(np.count_nonzero(~fixes.known))
    if unknown:
        return f"{unknown} of the {len(fixes)} paired fixes have no covariance"
    if len(fixes) < _FEWEST_FIXES:
        return f"too few fixes ({len(fixes)})"
    return ""


def _noise_corrected_ate(
    evaluation: Evaluation, correlation_s: float, jumps: Booleans, single_jumps: int
) -> NoiseCorrectedAte:
    fixes = evaluation.association.groundtruth.reading.fixes
    assert fixes is not None
    without = np.flatnonzero(~jumps)
    best = _of_rows(evaluation, without, correlation_s)
    everything = best
    if jumps.any():
        everything = _of_rows(evaluation, np.arange(len(jumps)), correlation_s)
    half_width = (best.interval_m[1] - best.interval_m[0]) / 2.0
    is_multipath = np.count_nonzero(jumps) > _MULTIPATH * len(jumps)
    return NoiseCorrectedAte(
        correlation_s=correlation_s,
        ate_m=best.ate_m,
        interval_m=best.interval_m,
        with_jumps_m=everything.ate_m,
        noise_rms_m=best.noise_rms_m,
        effective_fixes=best.effective,
        fixes=min(len(without), _MOST_FIXES),
        jumps=int(np.count_nonzero(jumps)),
        single_jumps=single_jumps,
        by_guess=bool((fixes.covariance_types == COVARIANCE_APPROXIMATED).any()),
        resolved=half_width <= best.ate_m / 2.0 and not is_multipath,
    )


def _of_rows(evaluation: Evaluation, rows: Indices, correlation_s: float) -> Debiased:
    """Return the debiased error of some pairs, aligned by these alone, thinned if too many."""
    if len(rows) > _MOST_FIXES:
        rows = rows[np.linspace(0, len(rows) - 1, _MOST_FIXES).round().astype(np.int64)]
    pairs, gauge = evaluation.association, evaluation.protocol.gauge
    groundtruth, estimate = pairs.groundtruth[rows], pairs.estimate[rows]
    pairs = dataclasses.replace(pairs, groundtruth=groundtruth, estimate=estimate)
    aligned = align_pairs(pairs, evaluation.protocol).similarity.positions(estimate.positions)
    assert groundtruth.covariances is not None
    covariances = groundtruth.covariances[:, :3, :3]
    if gauge is Gauge.PLANAR:
        covariances = covariances * np.outer([1.0, 1.0, 0.0], [1.0, 1.0, 0.0])
    correlations = correlations_of(groundtruth.stamps, correlation_s)
    return debiased(groundtruth.positions - aligned, aligned, covariances, correlations, gauge)


def _tangent(gauge: Gauge, aligned: Floats) -> Floats:
    """Return the derivatives (3N, k) of aligned positions by the gauge, about their mean."""
    centred = aligned - aligned.mean(axis=0)
    if gauge is Gauge.TRANSLATION:
        return orbit_basis(Gauge.YAW, centred)[:, :3, 1:].reshape(-1, 3)
    within = Gauge.YAW if gauge is Gauge.PLANAR else gauge
    basis = orbit_basis(within, centred)[:, :3]
    return basis.reshape(len(aligned) * 3, -1)


def _root(square: float) -> float:
    return float(np.sqrt(max(0.0, square)))


_TIMES_MEDIAN = 5.0
_LONGEST_NS = 30 * NANOSECONDS


def jumps_of(stamps: Stamps, errors: Floats) -> Booleans:
    """Return which pairs are in a jump (N,), by groundtruth minus aligned estimate (N, 3).

    A jump starts with a horizontal step of the error above five times the median step. It ends
    when the error is back within that distance of its value before the jump, or when later large
    steps have cancelled the first: a large jump rotates the alignment, so that the error drifts. A
    change that lasts 30 s is no jump. Stamps are increasing, z is up.
    """
    flags = np.zeros(len(errors), dtype=bool)
    level = errors[:, :2]
    moved = np.diff(level, axis=0)
    steps = np.hypot(*moved.T)
    if not len(steps):
        return flags
    limit = _TIMES_MEDIAN * float(np.median(steps))
    leaps = np.concatenate([[[0.0, 0.0]], np.cumsum(moved * (steps > limit)[:, None], axis=0)])
    past = 0
    for begin in np.flatnonzero(steps > limit).tolist():
        if begin < past:
            continue
        end = int(stamps.searchsorted(stamps[begin] + _LONGEST_NS))
        within = slice(begin + 1, end)
        near = np.hypot(*(level[within] - level[begin]).T) <= limit
        near |= np.hypot(*(leaps[within] - leaps[begin]).T) <= limit
        if near.any():
            past = begin + 1 + int(near.argmax())
            flags[begin + 1 : past] = True
    return flags
