"""Which definitions give published numbers, and how many would give an unrelated number.

A value x matches y if it rounds to the digits of y: |x - y| <= h, half a unit of the last digit.
An unrelated number is log-uniform within a factor of 2 of y. Then x matches with the probability
c: the length of [ln(x - h), ln(x + h)] in that range, per length 2 ln 2 of the range.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.explanation.definition import ALIGNMENTS, ASSOCIATIONS, Definition
from trajeval_ros.explanation.definition_values import values_of
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.trajectory import Trajectory

# Of published numbers: the unit of the definitions, and the factor to it.
UNITS: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0), "cm": ("m", 0.01), "mm": ("m", 0.001), "%": ("%", 1.0), "m/km": ("%", 0.1),
    "deg": ("deg", 1.0), "rad": ("deg", 180.0 / math.pi), "deg/m": ("deg/m", 1.0),
    "deg/100m": ("deg/m", 0.01),
}  # fmt: skip
_NUMBER = re.compile(r"([0-9]*\.?([0-9]*))(e[-+]?[0-9]{1,3})?\s*(%|[a-z].*)?", re.IGNORECASE)
_SAME_ARITHMETIC = 1e-7  # relative; programs differ by less in the same number
_SAME_VALUE = 1e-9
_RANGE = 2.0 * math.log(2.0)
_NONE_PRIOR = 0.3  # probability that a number has no definition in the search
# From this number of runs on, one of them may disagree with the definition of the others.
_RUNS_WITH_ONE_WRONG = 4
_ONE_WRONG_PRIOR = 0.1  # probability that one number of several is of another run or definition
_NAMED = 0.8  # least probability of a definition that is named
_NEAREST = 4
_PRIOR_WEIGHT = 0.02  # of the logarithm of the prior, against that of the value, for `nearest`
_MOST_NUMBERS = 2
_TINY = 1e-12


class PublishedNumber(NamedTuple):
    """A number in the unit of the definitions, and half a unit of its last digit."""

    value: float
    half: float
    unit: str  # empty: all

    @classmethod
    def parse(cls, text: str, unit: str = "") -> PublishedNumber:
        """Parse a number as it is printed, such as "0.20", or "1.25 deg" with its own unit.

        Raises:
            SettingsError: It is not the text of a positive number, or its unit is unknown.
        """
        if not isinstance(text, str):
            raise SettingsError(
                f"the number {text!r} has no digits to compare; give it as text, as in '0.20'"
            )
        match = _NUMBER.fullmatch(text.strip())
        value = float(match[1] + (match[3] or "")) if match and match[1].strip(".") else math.nan
        if not 0.0 < value < math.inf:
            raise SettingsError(
                f"{text!r} is not a published error; give a positive number and its unit, if any, "
                "as in 0.061 or 1.25deg"
            )
        assert match is not None
        unit = match[4] or unit
        if unit:
            require_one_of(unit, UNITS, "unit")
        base, factor = UNITS.get(unit, ("", 1.0))
        half = 0.5 * 10.0 ** (float((match[3] or "e0")[1:]) - len(match[2]))
        return cls(value * factor, max(half, _SAME_ARITHMETIC * value) * factor, base)


@dataclass(frozen=True)
class Match:
    """Definitions that differ only in the association, or have equal values."""

    definitions: tuple[Definition, ...]  # the likeliest one, of every number of a run
    # Its values by number of a run, and by run; metres, degrees, % or deg/m.
    values: tuple[tuple[float, ...], ...]
    associations: tuple[str, ...]  # all that give the numbers
    others: tuple[str, ...]  # other definitions with equal values, as text
    probability: float  # posterior probability of these definitions together


@dataclass(frozen=True)
class Explanation:
    """The definitions that give published numbers."""

    searched: int  # number of definitions with the unit of the numbers
    matching: int  # number of definitions that give the numbers
    expected: float  # expected number of matches of unrelated numbers of the same size
    any_probability: float  # probability that unrelated numbers have a match
    none_probability: float  # posterior probability that none of the definitions was used
    matches: tuple[Match, ...]  # groups of matching definitions, the likeliest first
    nearest: tuple[Match, ...]  # likely definitions with near values, if none matches
    # The run, counted from 0, whose number differs while those of all others match; else None.
    disagreeing: int | None = None

    @property
    def verdict(self) -> str:
        """`named`, `possible`, `chance` (as likely unrelated) or `none`."""
        if not self.matches:
            return "none"
        if self.matches[0].probability >= _NAMED:
            return "named"
        return "possible" if self.none_probability < 0.5 else "chance"


def explain(
    runs: Sequence[tuple[Trajectory, Trajectory, Sequence[str]]], unit: str = ""
) -> Explanation:
    """Return the definitions that give the published numbers of one or more runs.

    A named definition gives the digits. This does not prove that the authors used it.

    Args:
        runs: Groundtruth, estimate, and one or two numbers as texts, because "0.20" has more
            digits than "0.2". All runs have the same definition. From four runs on, the numbers
            of one may differ. The second number of a run has its own statistic, and the same
            association and alignment.
        unit: A key of `UNITS` for numbers without a unit; empty to search m, %, deg and deg/m.

    Raises:
        SettingsError: A number is not a text or not positive, or runs differ in their count.
        InputError: A run has no pairs.

    Example:
        >>> from trajeval_ros import evaluate, explain, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> rmse = evaluate(flight.groundtruth, flight.estimate).ate["position_m"].rmse
        >>> result = explain([(flight.groundtruth, flight.estimate, [f"{rmse:.5f}"])], unit="m")
        >>> str(result.matches[0].definitions[0])
        'position rmse, se3'
    """
    numbers = [[PublishedNumber.parse(text, unit) for text in texts] for _, _, texts in runs]
    counts = {len(number) for number in numbers}
    if len(counts) != 1 or not counts <= set(range(1, _MOST_NUMBERS + 1)):
        raise SettingsError(
            f"the runs have {', '.join(map(str, sorted(counts))) or 'no'} numbers; give every "
            f"run one number, or every run {_MOST_NUMBERS}"
        )
    candidates = _Candidates([values_of(truth, estimate) for truth, estimate, _ in runs])
    columns = [_Column(candidates, item) for item in zip(*numbers, strict=True)]
    result = _explained(candidates, columns)
    if result.matches or len(runs) < _RUNS_WITH_ONE_WRONG:
        return result
    return _with_one_wrong(candidates, numbers) or result


def _with_one_wrong(
    candidates: _Candidates, numbers: Sequence[Sequence[PublishedNumber]]
) -> Explanation | None:
    """Return the definitions that give the numbers of all runs but one; None without any.

    An unrelated number of the disagreeing run has the same likelihood with and without a
    definition for the others, so that it cancels in the posterior probability.
    """
    prior = _ONE_WRONG_PRIOR / len(numbers)
    results = []
    for run in range(len(numbers)):
        others = candidates.without(run)
        kept = [texts for number, texts in enumerate(numbers) if number != run]
        columns = [_Column(others, column) for column in zip(*kept, strict=True)]
        result = _explained(others, columns, prior)
        results.append(replace(result, disagreeing=run))
    matching = [result for result in results if result.matches]
    if not matching:
        return None
    expected = sum(result.expected for result in results)  # of as many attempts as runs
    return replace(
        min(matching, key=lambda result: result.none_probability),
        expected=expected,
        any_probability=-math.expm1(-expected),
    )


class _Candidates:
    """The K definitions that all R runs have, with their values."""

    def __init__(self, tables: Sequence[tuple[dict[Definition, int], list[float]]]) -> None:
        # Definitions with equal pairs in all runs count once.
        groups_of_values: dict[tuple[int, ...], list[Definition]] = {}
        for definition in tables[0][0]:
            if all(definition in places for places, _ in tables):
                key = tuple(places[definition] for places, _ in tables)
                groups_of_values.setdefault(key, []).append(definition)
        self.names = [
            sorted(item, key=lambda one: -one.prior) for item in groups_of_values.values()
        ]
        self.first = [name[0] for name in self.names]
        self.values: Floats = np.array(
            [
                [values[key[run]] for key in groups_of_values]
                for run, (_, values) in enumerate(tables)
            ]
        )  # (R, K), of the runs whose numbers are compared
        self.shown = self.values  # of all runs
        self.priors = np.array([item.prior for item in self.first])

    def without(self, run: int) -> _Candidates:
        """Return the candidates for the numbers of all runs but one."""
        others = copy.copy(self)
        others.values = np.delete(self.values, run, axis=0)
        return others

    def of_row(self, used: Sequence[Booleans]) -> Indices:
        """Return all definitions (M, C) of the C numbers in a row of a table, of those used (K,).

        They share an association and the alignment. Relative errors depend only on its scale.
        """
        if len(used) == 1:
            return np.flatnonzero(used[0])[:, None]
        alignment = np.array([item.alignment for item in self.first])
        scaled = np.array([ALIGNMENTS[item.alignment].has_scale for item in self.first])
        relative = np.array([bool(item.family) for item in self.first])
        either = (relative[:, None] | relative) & (scaled[:, None] == scaled)
        has = np.array([[name in {one.association for one in item} for name in ASSOCIATIONS]
            for item in self.names], dtype=float)  # fmt: skip
        together = (has @ has.T > 0.0) & (either | (alignment[:, None] == alignment))
        return np.argwhere(together & np.logical_and.outer(*used))

    def match(self, rows: Indices, probability: float) -> Match:
        """Return a group of definitions (M, C), the likeliest first."""
        named = [tuple(self.first[item] for item in row) for row in rows]
        texts = ["; ".join(map(str, item)) for item in named]
        associations = {one.association for row in rows for one in self.names[row[0]]}
        return Match(
            named[0],
            tuple(map(tuple, self.shown.T[rows[0]].tolist())),
            tuple(name for name in ASSOCIATIONS if name in associations),
            tuple(dict.fromkeys(texts))[1:],
            probability,
        )

    def are_one(self, row: Indices, other: Indices) -> bool:
        """Return whether definitions (C,) differ only in the association, or have equal values."""
        if all(self.first[a][1:] == self.first[b][1:] for a, b in zip(row, other, strict=True)):
            return True
        a, b = self.values[:, row], self.values[:, other]
        return bool((np.abs(a - b) <= _SAME_VALUE * b).all())


class _Column:
    """The K definitions for one number of all R runs."""

    def __init__(self, candidates: _Candidates, numbers: Sequence[PublishedNumber]) -> None:
        unit = numbers[0].unit
        self.used = np.array([not unit or item.unit == unit for item in candidates.first])
        y, h = (np.array([number[field] for number in numbers])[:, None] for field in (0, 1))
        x = np.maximum(candidates.values, _TINY)
        self.hit = (np.abs(x - y) <= h * (1.0 + 1e-9)).all(axis=0)
        bounds = np.log(np.maximum([x - h, x + h], _TINY) / y)
        self.low, self.high = np.clip(bounds, -_RANGE / 2.0, _RANGE / 2.0)  # (R, K)
        self.covered = np.prod((self.high - self.low) / _RANGE, axis=0)  # the probabilities c
        self.unrelated = float(np.prod(np.log((y + h) / (y - h)) / _RANGE))  # their likelihood
        self.distance = np.abs(np.log(x / y)).max(axis=0)

    def union(self) -> float:
        """Return the probability that any definition matches: of a single run."""
        low, high = self.low[0][self.used], self.high[0][self.used]
        order = np.argsort(low)
        low, high = low[order], np.maximum.accumulate(high[order])
        before = np.concatenate([[-np.inf], high[:-1]])
        return float(np.maximum(high - np.maximum(low, before), 0.0).sum()) / _RANGE


def _explained(
    candidates: _Candidates, columns: Sequence[_Column], prior: float = 1.0
) -> Explanation:
    """Return the definitions that give the numbers.

    `prior`: probability that these runs have one definition, if any run has one.
    """
    rows = candidates.of_row([column.used for column in columns])

    def of_rows(values: Sequence[Floats]) -> Floats:
        return np.array([value[row] for value, row in zip(values, rows.T, strict=True)])

    weights = candidates.priors[rows].prod(axis=1)
    weights /= weights.sum()
    hit = of_rows([column.hit for column in columns]).all(axis=0)
    expected = float(of_rows([column.covered for column in columns]).prod(axis=0).sum())
    is_single = len(candidates.values) == len(columns) == 1
    likely = columns[0].union() if is_single else -math.expm1(-expected)
    unrelated = _NONE_PRIOR * math.prod(column.unrelated for column in columns)
    matching = float(weights[hit].sum())
    none = unrelated / (unrelated + (1.0 - _NONE_PRIOR) * prior * matching)
    if hit.any():
        matches = _grouped(candidates, rows[hit], (1.0 - none) * weights[hit] / matching)
        return Explanation(len(rows), int(hit.sum()), expected, likely, none, matches, ())
    far = of_rows([column.distance for column in columns]).max(axis=0)
    near = np.argsort(far - _PRIOR_WEIGHT * np.log(weights))[: 4 * _NEAREST]
    # Halved shares keep the order of the nearest definition of every group.
    nearest = _grouped(candidates, rows[near], np.power(0.5, np.arange(float(len(near)))))
    return Explanation(len(rows), 0, expected, likely, none, (), nearest[:_NEAREST])


def _grouped(candidates: _Candidates, rows: Indices, shares: Floats) -> tuple[Match, ...]:
    """Join matches (M, C) that differ only in the association, or have equal values."""
    groups: list[list[int]] = []
    for place in np.argsort(-shares, kind="stable").tolist():
        same = (item for item in groups if candidates.are_one(rows[place], rows[item[0]]))
        group = next(same, None)
        if group is None:
            groups.append([place])
        else:
            group.append(place)
    matches = [candidates.match(rows[item], float(shares[item].sum())) for item in groups]
    return tuple(sorted(matches, key=lambda item: -item.probability))
