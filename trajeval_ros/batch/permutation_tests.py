"""Exact tests of a gate: stratified permutation tests of mean differences of logarithms.

If nothing changed, the labels "old" and "new" are exchangeable within every sequence, for any
distribution of the errors; with pairs that share a seed, within every pair. The values of a
statistic under all relabellings are its distribution without a change.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

MOST = 9999  # relabellings; all of them if they are not more
POWER = 0.8
_POWER_RELABELLINGS, _POWER_ACTUAL = 499, 100
_LARGEST = math.log(1e3)  # change that is searched for
_TIE = 1e-9  # relative: sums of the same terms in another order are equal


class Sample:
    """Runs of one algorithm on one sequence; their difference is `labels @ scores / weight`."""

    def __init__(self, old: Floats, new: Floats, *, paired: bool = False) -> None:
        """Create a sample of logarithms (runs, metrics), NaN for failed runs."""
        values = new - old if paired else np.concatenate([old, new])
        rows, first = len(values), 0 if paired else len(old)
        self._paired, self._first = paired, first
        self.degrees = rows - (not paired)  # degrees of freedom of the scores
        self._known: Booleans = np.isfinite(values)
        # True labels, (rows,): 0 of old and 1 of new runs; 1 of pairs, -1 of swapped ones.
        self.labels = (np.arange(rows) >= first).astype(np.float64)
        # Whether both sides have a value, (metrics,).
        self.judged: Booleans = self._known[first:].any(0) & self._known[: first or rows].any(0)
        # Logarithms less their mean, or differences of pairs, (rows, metrics); 0 if missing.
        self.scores = self._centred(values, self._known)
        # Change of the scores if all new logarithms increase by one, (rows, metrics).
        self.units = self._centred(self.labels[:, None], self._known)
        # Inverse variance of the difference if a row has 1.
        self.weight = float(rows) if paired else len(old) * len(new) / rows
        # Number of different relabellings.
        self.count = 2**rows if paired else math.comb(rows, first)

    def units_of(self, labels: Floats, metric: int) -> Floats:
        """Return `units` of a metric if labels (count, rows) were the true ones, (rows, count)."""
        return self._centred(labels.T, self._known[:, metric : metric + 1])

    def _centred(self, values: Floats, known: Booleans) -> Floats:
        filled = np.where(known, values, 0.0)
        mean = 0.0 if self._paired else filled.sum(0) / np.maximum(known.sum(0), 1)
        return np.where(known, filled - mean, 0.0)

    def error(self, squares: Floats) -> Floats:
        """Return the standard error over relabellings, by the sum of squares of scores."""
        return np.asarray(np.sqrt(squares / (self.weight * self.degrees)))

    def error_within(self, squares: Floats, differences: Floats) -> Floats:
        """Return the standard error within sides, which depends on the labels."""
        if self.degrees < 2:
            return self.error(squares)
        rest = np.maximum(squares - self.weight * differences**2, 0.0)
        return np.asarray(np.sqrt(rest / (self.weight * (self.degrees - 1))))

    def relabellings(self) -> Floats:
        """Return all labels, the true ones first, (count, rows)."""
        if self._paired:
            return np.array(list(itertools.product((1.0, -1.0), repeat=len(self.labels))))
        made = np.ones((self.count, len(self.labels)))
        old = list(itertools.combinations(range(len(self.labels)), self._first))
        np.put_along_axis(made, np.array(old), 0.0, axis=1)
        return made

    def random_relabellings(self, count: int, random: np.random.Generator) -> Floats:
        """Return the true labels and random ones, (1 + count, rows)."""
        made = np.tile(self.labels, (1 + count, 1))
        if self._paired:
            made[1:] -= 2.0 * random.integers(0, 2, made[1:].shape)
        else:
            made[1:] = random.permuted(made[1:], axis=1)
        return made


def relabellings(
    samples: Sequence[Sample], most: int, random: np.random.Generator | None = None
) -> Iterator[Floats]:
    """Yield the labels of every sample, (relabellings, rows), the true ones first.

    These are all joint relabellings, or if there are more than `most`, the true one and `most`
    random ones: the p-value (1 + hits) / (1 + most) is then valid, too.
    """
    random = random or np.random.default_rng(0)
    total = math.prod(sample.count for sample in samples)
    place = np.arange(total if total <= most else 0)
    for sample in samples:
        if total > most:
            yield sample.random_relabellings(most, random)
        else:
            yield sample.relabellings()[place % sample.count]
            place = place // sample.count


def p_values(relabelled: Floats, observed: Floats) -> Floats:
    """Return the share of relabellings (count,) that reach observed statistics of any shape."""
    least = observed - _TIE * (1.0 + np.abs(observed))
    below = np.searchsorted(np.sort(relabelled), least)
    return np.asarray((len(relabelled) - below) / len(relabelled))


def can_reject(count: int, level: float) -> bool:
    """Return whether the smallest p-value of this number of relabellings reaches a level."""
    return count >= (1.0 - _TIE) / level


@dataclass(frozen=True, eq=False)
class OneSidedTests:
    """The tests of one direction: new errors are larger than the margin, or smaller."""

    together: Floats  # p-values of all sequences, (metrics,), adjusted for all metrics
    alone: Floats  # p-values, (sequences, metrics), adjusted for all of them
    level_together: float
    level_alone: float  # 0 if no sequence is tested alone
    shares: Floats  # level of a metric without adjustment that gives the same verdict, (metrics,)

    @classmethod
    def of(cls, z: Floats, t: Floats, largest_t: Floats, level: float) -> OneSidedTests:
        """Test by z (relabellings, metrics), t and its largest values (relabellings,)."""
        largest, half = z.max(1), level / 2.0
        together, alone = p_values(largest, z[0]), np.ones(t.shape)
        level_together, level_alone = level, 0.0
        if largest_t.ndim:  # a sequence is tested alone
            alone = p_values(largest_t, t)
            level_together = level if alone.min() <= half else half
            level_alone = level if together.min() <= half else half
        critical = np.sort(largest)[-1 - math.floor(level_together * len(z) + _TIE)]
        shares = (z > critical + _TIE * (1.0 + abs(critical))).mean(0)
        shares = shares if len(shares) > 1 else np.array([level_together])
        return cls(together, alone, level_together, level_alone, shares)


class PermutationTest:
    """The tests of all metrics and sequences of one comparison.

    The common change is a weighted mean of differences d. The weights 1 / (s + s0) are independent
    of labels: s is the standard error over relabellings, s0 its median over sequences. Single
    sequences have the moderated t of Tusher, Tibshirani and Chu (2001), d / (e + s0), with the
    standard error e within sides. The largest statistic of the family adjusts for its size (max-T
    of Westfall and Young). Both questions share the level by Holm's method.
    """

    def __init__(
        self,
        samples: Sequence[Sample],
        margins: Floats,
        level: float,
        most: int = MOST,
        random: np.random.Generator | None = None,
    ) -> None:
        """Test logarithms of errors against the logarithms of the margins, (metrics,)."""
        self._samples, self._margins, self._half = samples, margins, level / 2.0
        self._scores = [item.scores - margins * item.units for item in samples]
        self._judged = np.array([item.judged for item in samples])
        # Whether a sequence is tested alone, (sequences,); this depends on sizes only.
        self.tests_alone = np.array([can_reject(item.count, self._half) for item in samples])
        self.tests_alone &= len(samples) > 1
        pairs = list(zip(samples, self._scores, strict=True))
        errors = np.array([item.error((scores**2).sum(0)) for item, scores in pairs])
        columns = zip(errors.T, self._judged.T, strict=True)
        self._typical = np.maximum([np.median(error[judged]) for error, judged in columns], _TIE)
        self._weights = self._judged / (errors + self._typical)
        t, largest, smallest = np.zeros(errors.shape), np.array(-np.inf), np.array(np.inf)
        sums, units = np.zeros((2, 1, 1))
        for place, labels in enumerate(relabellings(samples, most, random)):
            sample, scores = pairs[place]
            differences = labels @ scores / sample.weight
            sums = sums + self._weights[place] * differences
            units = units + self._weights[place] * (labels @ sample.units / sample.weight)
            if self.tests_alone[place]:
                error = sample.error_within((scores**2).sum(0), differences)
                every = np.where(sample.judged, differences / (error + self._typical), np.nan)
                t[place] = every[0]
                largest = np.fmax(largest, np.fmax.reduce(every, axis=1))
                smallest = np.fmin(smallest, np.fmin.reduce(every, axis=1))
        deviations = np.sqrt(((self._weights * errors) ** 2).sum(0))
        z = sums / np.where(deviations > 0.0, deviations, np.inf)
        self.worse = OneSidedTests.of(z, t, largest, level)  # the tests for larger errors
        self.better = OneSidedTests.of(-z, -t, -smallest, level)  # the tests for smaller errors
        # The statistic is linear in a shift of new errors: estimate and bounds need no iteration.
        # Estimated common change of logarithms, (metrics,).
        self.change = margins + sums[0] / units[0]
        low, high = (
            [_lower_bound(*item) for item in zip(side_sums.T, units.T, side.shares, strict=True)]
            for side_sums, side in ((sums, self.worse), (-sums, self.better))
        )
        # Its confidence bounds at the level of the verdict, infinite for none, (metrics,).
        self.low, self.high = margins + np.array(low), margins - np.array(high)

    def detectable(self) -> tuple[Floats, Floats]:
        """Return the worsening that is detected with a power of 80 % (logarithm); inf for none.

        The power is that of relabelled runs: the estimated change is removed, relabellings are the
        actual labels, one after the other, and a worsening is added to their new runs.

        Returns:
            The common worsening, (metrics,), and that of single sequences, (sequences, metrics).
        """
        labels = list(relabellings(self._samples, _POWER_RELABELLINGS))
        count = len(labels[0])
        actual = np.random.default_rng(0).permutation(count)[:_POWER_ACTUAL]

        def worse(place: int, k: int, change: float, degrees: int) -> _Worse:
            sample = self._samples[place]
            rest = self._scores[place][:, k] - change * sample.units[:, k]
            rest *= math.sqrt(degrees / max(degrees - 1, 1))  # one is lost with the change
            units = sample.units_of(labels[place][actual], k)
            return _Worse(sample, rest, units, labels[place], self._typical[k])

        common, alone = np.full(len(self._margins), np.inf), np.full(self._judged.shape, np.inf)
        degrees = sum(item.degrees for item in self._samples)
        for k, change in enumerate(self.change - self._margins):
            places = np.flatnonzero(self._judged[:, k]).tolist()
            runs = [worse(place, k, change, degrees) for place in places]
            level = self.worse.shares[k]
            if level > 0.0 and count > _POWER_RELABELLINGS:
                level = max(level, 1.0 / count)
            least = _least(partial(_weighted, runs), -np.inf, actual, level, self._typical[k])
            common[k] = self._margins[k] + least
        single: dict[tuple[int, int], _Worse] = {}
        for place, k in zip(*np.nonzero(self._judged & self.tests_alone[:, None]), strict=True):
            sample, scores = self._samples[place], self._scores[place][:, k]
            change = (sample.labels @ scores) / (sample.labels @ sample.units[:, k])
            single[place, k] = worse(place, k, change, sample.degrees)
        t = np.array([item.t(0.0)[:, 0] for item in single.values()])
        for row, ((place, k), item) in enumerate(single.items()):
            others = np.delete(t, row, axis=0).max(0, initial=-np.inf)[:, None]
            least = _least(item.t, others, actual, self._half, self._typical[k])
            alone[place, k] = self._margins[k] + least
        return common, alone


def _lower_bound(sums: Floats, units: Floats, share: float) -> float:
    """Return the largest shift of new errors up to which the test rejects; -inf for none.

    The statistics at a shift are `sums - shift * units`, (relabellings,), of the actual labels
    first. Every relabelling reaches the actual one from one shift on, so the bound is an order
    statistic. A share of the relabellings may reach the actual one, itself included.
    """
    slower = units[0] - units
    thresholds = np.full(len(sums), -np.inf)  # those with the units of the actual labels reach it
    np.divide(sums[0] - sums, slower, out=thresholds, where=slower > _TIE * units[0])
    return float(np.sort(thresholds)[math.floor(share * len(sums) + _TIE)])


class _Worse:
    """Runs of a sequence if relabellings are the actual labels, and their new runs are worse by x.

    Scores are `rest + x * units`, (rows,) and (rows, actual); labels are (relabellings, rows).
    """

    def __init__(
        self, sample: Sample, rest: Floats, units: Floats, labels: Floats, typical: float
    ) -> None:
        self.sample, self._typical = sample, typical
        self._rest = (labels @ rest / sample.weight)[:, None]
        self._units = labels @ units / sample.weight
        self._squares = rest @ rest, 2.0 * rest @ units, (units**2).sum(0)

    def at(self, x: float) -> tuple[Floats, Floats]:
        """Return differences, (relabellings, actual), and sums of squares of scores, (actual,)."""
        squares, linear, quadratic = self._squares
        squares = np.maximum(squares + x * linear + x**2 * quadratic, 0.0)
        return self._rest + x * self._units, squares

    def t(self, x: float) -> Floats:
        """Return moderated t, (relabellings, actual)."""
        differences, squares = self.at(x)
        error = self.sample.error_within(squares, differences)
        return np.asarray(differences / (error + self._typical))


def _weighted(runs: Sequence[_Worse], x: float) -> Floats:
    """Return the statistic of all sequences together, (relabellings, actual)."""
    differences, squares = zip(*(run.at(x) for run in runs), strict=True)
    errors = np.array(
        [run.sample.error(square) for run, square in zip(runs, squares, strict=True)]
    )
    weights = 1.0 / (errors + np.maximum(np.median(errors, axis=0), _TIE))
    return reduce(np.add, map(np.multiply, differences, weights))


def _least(
    statistic: Callable[[float], Floats],
    others: Floats | float,
    actual: Indices,
    level: float,
    step: float,
) -> float:
    """Return the smallest change that is detected for a share `POWER` of labels; inf for none.

    The largest of a statistic (relabellings, actual) and of others must reach the actual one.
    """

    def is_detected(x: float) -> bool:
        made = statistic(x)
        reached = made[actual, np.arange(len(actual))]
        p = (np.maximum(made, others) >= reached - _TIE * (1.0 + np.abs(reached))).mean(0)
        return bool((p <= level).mean() >= POWER)

    low, high = 0.0, step
    while not is_detected(high):
        low, high = high, 2.0 * high
        if high > _LARGEST:
            return math.inf
    for _ in range(7):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_detected(middle) else (middle, high)
    return high


def more_failures(before: Sequence[Booleans], now: Sequence[Booleans]) -> float:
    """Return the p-value of more failed runs, (runs,) by sequence: Mantel and Haenszel's test."""
    sides = zip(before, now, strict=True)
    samples = [Sample(*(item[:, None].astype(np.float64) for item in side)) for side in sides]
    labels = relabellings(samples, MOST)
    sums = sum(label @ sample.scores[:, 0] for label, sample in zip(labels, samples, strict=True))
    return float(p_values(np.asarray(sums), np.asarray(sums)[:1])[0])


def more_trials(sizes: Sequence[tuple[int, int]], level: float) -> int:
    """Return how many more new trials per sequence all together need to be tested; 0 for none."""
    counts = (math.prod(math.comb(old + new + more, old) for old, new in sizes)
              for more in itertools.count())  # fmt: skip
    return next(more for more, count in enumerate(counts) if can_reject(count, level))


def equal_trials(sequences: int, level: float) -> int:
    """Return the least number of trials on both sides with which a test can reject."""
    counts = (math.comb(2 * trials, trials) ** sequences for trials in itertools.count(1))
    return next(trials for trials, count in enumerate(counts, 1) if can_reject(count, level))
