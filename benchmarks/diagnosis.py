"""What a diagnosis names, and how often it alarms on a right recording: make bench-diagnosis.

Prints tables in Markdown: the matrix of mistakes, false alarms in two halves, pairs of mistakes,
thinned, short and planar runs, and CPU time. Real recordings are left out where their folder is
missing.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.diagnosis_cost import cost, cost_of_mistakes
from benchmarks.diagnosis_discontinuities import DISCONTINUITIES
from benchmarks.diagnosis_further import FURTHER
from benchmarks.diagnosis_mistakes import MISTAKES, Mistake
from benchmarks.diagnosis_runs import (
    DRIFTS,
    KINDS,
    Pair,
    recorded,
    simulated,
    with_outliers,
)
from benchmarks.diagnosis_sizes import SIZES
from benchmarks.diagnosis_users import USERS
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.pipeline.diagnosing import diagnose
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.preparation import Inputs, corrected_and_cut
from trajeval_ros.pipeline.request import Request

RIGHT, TIE, SILENT, WRONG = "named", "tie", "silent", "wrong"
# The last says that clocks differ, and not that their rates do.
_TIES = {"convention_tie", "up_axis_or_mirrored", "small_clock_offset"}
_KNOWN = {"S-PTAM": "small_clock_offset"}  # its stamps are late


def diagnosis_of(pair: Pair) -> Diagnosis:
    """Diagnose a pair as `trajeval diagnose` does, with tried advice."""
    return diagnose(pair.truth, pair.estimate, Request(pair.protocol))[0]


def verdict(pair: Pair, diagnosis: Diagnosis, causes: Iterable[str]) -> str:
    """Return what became of a mistake."""
    first = next(
        (finding for finding in diagnosis.findings if not _is_known(pair, finding.cause)), None
    )
    if first is None:
        return SILENT
    if first.cause in causes:
        return RIGHT
    return TIE if first.cause in _TIES else WRONG


def _is_known(pair: Pair, cause: str) -> bool:
    return _KNOWN.get(pair.name.split()[0]) == cause


def matrix(pairs: list[Pair], mistakes: dict[str, Mistake]) -> None:
    """Print how each mistake is named on each kind of recording, and corrected.

    A mistake is corrected if, after `--correct suggested`, both ATE are within 5 % of those
    without the mistake, by the same gauge over the same time.
    """
    kinds = {"real": [], "simulated": []}  # type: dict[str, list[Pair]]
    for pair in pairs:
        kinds["simulated" if pair.name.split()[0] in KINDS else "real"].append(pair)
    print("\n| mistake | real | simulated | corrected | otherwise |\n|---|---|---|---|---|")
    total: collections.Counter[str] = collections.Counter()
    for name, mistake in mistakes.items():
        cells, others = [], []
        options = good = 0
        for group in kinds.values():
            count: collections.Counter[str] = collections.Counter()
            for pair in group:
                if not mistake.applies(pair):
                    continue
                wrong = mistake.make(pair)
                what = diagnosis_of(wrong)
                text = verdict(pair, what, mistake.causes)
                count[text] += 1
                if text != RIGHT:
                    top = what.suggested.cause if what.suggested else SILENT
                    others.append(f"{pair.name} ({top})")
                elif what.suggested is not None and what.suggested.correction:
                    options += 1
                    ratio = left_by_corrections(pair, wrong)
                    good += ratio < CORRECTED
                    if ratio >= CORRECTED:
                        others.append(f"{pair.name} (ATE {ratio:.2f} times)")
            total += count
            cells.append("/".join(str(count[item]) for item in (RIGHT, TIE, SILENT, WRONG)))
        total += collections.Counter({"with an option": options, "corrected": good})
        print(
            f"| {name} | {' | '.join(cells)} | {good} of {options} | {', '.join(others)} |",
            flush=True,
        )
    everything = sum(total[item] for item in (RIGHT, TIE, SILENT, WRONG))
    print(f"all {everything}: " + ", ".join(f"{n} {item}" for item, n in total.items()))


CORRECTED = 1.05


def left_by_corrections(pair: Pair, wrong: Pair) -> float:
    """Return the ATE after `--correct suggested` over the one without the mistake, the larger."""
    request = Request(wrong.protocol, correct="suggested")
    try:
        after = run(wrong.truth, [wrong.estimate], request).runs[0]
        steps = [item.correction for item in after.corrected]
    except TrajevalError:  # nothing can be evaluated before
        advised = diagnosis_of(wrong).suggested
        assert advised is not None
        steps = [advised.correction]
        request = dataclasses.replace(request.corrected(steps[0]), correct="")
        after = run(wrong.truth, [wrong.estimate], request).runs[0]
    plain = Request(pair.protocol)
    for step in steps:
        kept = {name: step[name] for name in ("gauge", "end") if name in step}
        plain = plain.corrected(kept)
    truth = wrong.truth if any("max_gap" in step for step in steps) else pair.truth
    best = run(truth, [pair.estimate], plain).runs[0]
    ratios = []
    for metric in ("position_m", "rotation_deg"):
        ate, right = after.evaluation.ate[metric], best.evaluation.ate[metric]
        if right is not None:
            ratios.append(np.inf if ate is None else ate.rmse / right.rmse)
    return float(max(ratios))


def right(
    pairs: list[Pair], seed: int, count: int, worse: float, drifts: Sequence[str] = DRIFTS
) -> Iterator[Pair]:
    """Yield right recordings: real ones and parts of them, and simulated ones."""
    random = np.random.default_rng(seed)
    for pair in pairs:
        yield pair
        whole_s = pair.estimate.duration_s
        for _ in range(count // 6):
            long_s = random.uniform(20.0, 120.0)
            part = pair.part(random.uniform(0.0, max(whole_s - long_s, 0.0)), long_s)
            if long_s < whole_s and min(len(part.truth), len(part.estimate)) > 10:
                yield part
    for number in range(count):
        kind, drift = KINDS[number % 4], drifts[number // 4 % len(drifts)]
        duration_s = random.uniform(20.0, 150.0)
        yield simulated(10_000 * (seed + 1) + number, kind, drift, duration_s, worse=worse)


def spoilt(pairs: list[Pair], count: int, *, lost: bool) -> Iterator[Pair]:
    """Yield right recordings with 1 and with 3 series of 1 and of up to 5 outliers."""
    for pair in right(pairs, 403, count, 1.0):
        for seed, (number, longest) in enumerate(itertools.product((1, 3), (1, 5))):
            yield with_outliers(pair, seed, number, longest, lost=lost)


def alarms(title: str, pairs: Iterable[Pair]) -> None:
    """Print how many right recordings alarm."""
    number, named = 0, []
    for pair in pairs:
        diagnosis = diagnosis_of(pair)
        number += 1
        causes = [one.cause for one in diagnosis.findings if not _is_known(pair, one.cause)]
        if causes:
            named.append(f"{pair.name} ({causes[0]})")
    print(f"| {title} | {len(named)} of {number} | {', '.join(named)} |", flush=True)


def combinations(pairs: list[Pair]) -> None:
    """Print whether both of two mistakes are named, one after the other is corrected."""
    firsts = {
        "mirrored": ("mirrored",),
        "wxyz, estimate": ("wxyz",),
        "inverse, estimate": ("inverse",),
        "clock +18 s": ("clock_offset",),
        "transposed rotations": ("transposed",),
    }
    seconds = {
        "estimate in mm": ("unit",),
        "scale lost": ("scale",),
        "marker": ("body",),
        "groundtruth in mm": ("unit",),
        "NED": ("up_axis", "up_axis_or_mirrored"),
        "camera axes": ("up_axis",),
    }
    both = 0
    graver = 0
    rows = list(itertools.product(firsts, seconds))
    for number, (one, other) in enumerate(rows):
        pair = pairs[number % len(pairs)]
        wrong = MISTAKES[one].make(MISTAKES[other].make(pair))
        expected = set(firsts[one]) | set(seconds[other])
        first = diagnosis_of(wrong).suggested
        causes = [first.cause if first else SILENT]
        if first is not None and first.correction:
            after = diagnosis_of(corrected(wrong, dict(first.correction)))
            causes.append(after.suggested.cause if after.suggested else SILENT)
        graver += causes[0] in expected
        named = causes[0] in expected and len(causes) > 1 and causes[1] in expected - {causes[0]}
        both += named
        if not named:
            print(f"  {one} and {other} on {pair.name}: {' then '.join(causes)}")
    print(f"{len(rows)} pairs of mistakes: {graver} graver ones named, {both} both, corrected")


def corrected(pair: Pair, correction: dict[str, str]) -> Pair:
    """Return a pair as `--correct` reads it."""
    request = Request(pair.protocol).corrected(correction)
    sides = corrected_and_cut(Inputs(pair.truth, pair.estimate), request)
    shift = round(1e9 * request.protocol.association.time_offset_s)
    estimate = dataclasses.replace(sides.estimate, stamps=sides.estimate.stamps + shift)
    gauge = request.protocol.gauge
    return dataclasses.replace(pair, truth=sides.groundtruth, estimate=estimate, gauge=gauge)


def thinned(pairs: list[Pair]) -> None:
    """Print what is said of runs that show little."""
    changes = {
        "2 Hz": lambda pair: _every(pair, 0.5),
        "1 Hz": lambda pair: _every(pair, 1.0),
        "3 s": lambda pair: pair.part(0.4 * pair.estimate.duration_s, 3.0),
        "positions only": _positions,
    }
    mistakes = ("wxyz, estimate", "mirrored", "inverse, estimate", "clock +18 s", "marker")
    for title, change in changes.items():
        counts: collections.Counter[str] = collections.Counter()
        for pair, name in itertools.product(pairs, mistakes):
            if title == "positions only" and name not in ("mirrored", "clock +18 s"):
                continue
            mistake = MISTAKES[name]
            changed = change(mistake.make(pair))
            if not (len(changed.truth) and len(changed.estimate)):
                continue
            diagnosis = diagnosis_of(changed)
            text = verdict(pair, diagnosis, mistake.causes)
            if text == WRONG and diagnosis.suggested is not None:
                print(f"  {title}: {name} on {pair.name}: {diagnosis.suggested.cause}")
            counts[text] += 1
        print(f"{title}: mistakes " + ", ".join(f"{n} {item}" for item, n in counts.items()))


def strangers(pairs: list[Pair]) -> None:
    """Print how groundtruth of another run is called, from the same start on."""
    counts: collections.Counter[str] = collections.Counter()
    for one, other in itertools.permutations(pairs, 2):
        # Two estimates of one flight have the same groundtruth.
        if one.name.split()[-1] == other.name.split()[-1] or not _begin_together(one, other):
            continue
        stamps = other.truth.stamps - int(other.truth.stamps[0]) + int(one.estimate.stamps[0])
        truth = dataclasses.replace(other.truth, stamps=stamps)
        max_gap_s = max(one.max_gap_s, other.max_gap_s)
        stranger = dataclasses.replace(one, truth=truth, max_gap_s=max_gap_s)
        diagnosis = diagnosis_of(stranger)
        text = verdict(stranger, diagnosis, ("other_run",))
        if text == WRONG and diagnosis.suggested is not None:
            print(f"  {one.name} with {other.name}: {diagnosis.suggested.cause}")
        counts[text] += 1
    print("groundtruth of another run: " + ", ".join(f"{n} {item}" for item, n in counts.items()))


def _begin_together(one: Pair, other: Pair) -> bool:
    """Leave out two estimators of the bag's one robot."""
    return {one.name, other.name} != {"ORB-SLAM", "S-PTAM"}


def _every(pair: Pair, step_s: float) -> Pair:
    stamps = pair.estimate.stamps
    ticks = (stamps - stamps[0]) // round(1e9 * step_s)
    rows = np.flatnonzero(np.diff(ticks, prepend=-1) > 0)
    return dataclasses.replace(pair, estimate=pair.estimate[rows])


def _positions(pair: Pair) -> Pair:
    return dataclasses.replace(pair, truth=dataclasses.replace(pair.truth, quaternions=None))


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument(
        "--only",
        default="matrix,further,users,sizes,alarms,combinations,strangers,thinned,cpu,ratios",
    )
    parser.add_argument(
        "--seed", type=int, default=5000, help="of the simulated runs; 5000 chose the limits"
    )
    parser.add_argument("--half", choices=("", "first", "second"), default="", help="of the data")
    parser.add_argument("--count", type=int, default=120)
    options = parser.parse_args()
    expected = options.only.split(",")
    real = list(recorded(options.data)) if options.data.is_dir() else []
    if options.half:
        real = real[options.half == "second" :: 2]
    made = [
        simulated(options.seed + number, kind, drift, 100.0)
        for number, (kind, drift) in enumerate(itertools.product(KINDS, ("walk", "heavy")))
    ]
    print("named / stated as a tie / silent / wrong")
    if "matrix" in expected:
        matrix(real + made, MISTAKES)
    if "further" in expected:
        matrix(real + made, FURTHER)
    if "users" in expected:
        matrix(real + made, USERS)
    if "sizes" in expected:
        matrix(real, SIZES)
    if "alarms" in expected:
        more = options.seed - 5000
        print("\n| right recordings | alarms | which |\n|---|---|---|")
        alarms("first half", right(real[::2], more, options.count // 2, 1.0))
        alarms("second half", right(real[1::2], more + 1, options.count // 2, 1.0))
        alarms("drift 5 times worse", right([], more + 2, options.count, 5.0))
        alarms("drift 5 times worse, more", right([], more + 104, 2 * options.count, 5.0))
        alarms("drift 5 times worse, fresh seeds", right([], more + 205, 4 * options.count, 5.0))
        for number, tail in enumerate(("t2", "heavier", "t1.2")):
            heavier = right([], more + 400 + number, 2 * options.count, 5.0, (tail,))
            alarms(f"drift 5 times worse, tails {tail}", heavier)
        for lost in (False, True):
            alarms("series of outliers" + ", lost" * lost, spoilt(real, options.count, lost=lost))
        positions = (_positions(item) for item in right(real, more + 3, options.count, 1.0))
        alarms("positions only", positions)
        alarms("2 Hz", (_every(item, 0.5) for item in real))
        alarms("1 Hz", (_every(item, 1.0) for item in real))
    if "combinations" in expected:
        yaw = [pair for pair in real + made if pair.gauge.yaw_only]
        combinations(yaw)
    if "strangers" in expected:
        strangers(real + made)
    if "thinned" in expected:
        thinned(real + made)
    if "cpu" in expected:
        cost()
    if "ratios" in expected:
        kinds = {**MISTAKES, **FURTHER, **USERS, **SIZES, **DISCONTINUITIES}
        cost_of_mistakes(kinds, (10_000, 100_000))


if __name__ == "__main__":
    main()
