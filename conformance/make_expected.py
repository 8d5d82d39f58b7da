"""Computes the expected values of all cases with 60 digits, from the text of their files.

    python make_expected.py [CASE...]     write cases/*/expected.json and SHA256SUMS

Needs mpmath. The definitions are those of README.md.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import random
import sys
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from catalogue import (
    ABOUT,
    ASSOCIATION_CASES,
    KITTI_CASES,
    RELATIVE_CASES,
    UNCERTAIN,
    UNDETERMINED,
)
from mpmath import atan2, cos, det, diag, matrix, mp, mpf, nstr, sin, sqrt, svd_r

mp.dps = 60
HERE = Path(__file__).parent
LIMIT_NS = 20_000_000  # largest time difference of rule `nearest`
GAP_NS = 500_000_000  # longest step of the groundtruth that rule `linear` interpolates
DIGITS = 50
# Relative tolerance; 1e-9 is far above rounding, and below what a paper prints.
RELATIVE = mpf("1e-9")
# A tool passes if its number is exact for inputs and sums that differ by rounding: the absolute
# tolerance is this multiple of the largest change that such differences caused in `DRAWS` draws,
# and of one step of float64 at the largest coordinate, or in an angle of 1 rad.
ROUNDINGS, DRAWS = 10, 3
STEP = mpf(2) ** -52

STATISTICS = ("rmse", "mean", "median", "max")
ALIGNMENTS = (
    "none", "translation", "yaw", "se3", "sim3",
    "yaw_first_1", "se3_first_1", "yaw_first_10", "se3_first_10",
)  # fmt: skip
FORMS = ("se3", "yaw", "tutorial_se3", "tutorial_yaw")
KITTI_LENGTHS = (100, 200, 300, 400, 500, 600, 700, 800)


class State(NamedTuple):
    """A timestamp in ns, a position and a rotation matrix."""

    stamp: int
    p: Any
    R: Any


Pairs = list[tuple[State, State]]


def read(path: Path) -> list[tuple[int, list[mpf]]]:
    """Return the rows of a text file: timestamps in ns, and the other columns exactly."""
    rows = []
    for text in path.read_text(encoding="ascii").splitlines():
        words = text.split()
        if words and not words[0].startswith("#"):
            rows.append((int(Decimal(words[0]) * 10**9), [mpf(word) for word in words[1:]]))
    return rows


def rotation_matrix(x: mpf, y: mpf, z: mpf, w: mpf) -> Any:
    """Return the matrix of a quaternion of any norm."""
    s = 2 / (x * x + y * y + z * z + w * w)
    return matrix([
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ])  # fmt: skip


def states(rows: list[tuple[int, list[mpf]]]) -> list[State]:
    """Return states in the order of time, the first of equal timestamps."""
    first: dict[int, State] = {}
    for stamp, (px, py, pz, *q) in rows:
        first.setdefault(stamp, State(stamp, matrix([px, py, pz]), rotation_matrix(*q)))
    return [first[stamp] for stamp in sorted(first)]


def angle(R: Any) -> mpf:
    """Return the angle of a rotation matrix, rad."""
    return atan2(norm(axial(R)) / 2, (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2)


def axial(R: Any) -> Any:
    """Return twice the sine of a rotation's angle times its axis."""
    return matrix([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def norm(v: Any) -> mpf:
    """Return the length of a vector."""
    return sqrt(sum(c * c for c in v))


def about_axis(R: Any, share: mpf) -> Any:
    """Return the rotation about the same axis by a share of the angle (Rodrigues)."""
    v, a = axial(R), angle(R)
    if norm(v) == 0:
        return mp.eye(3)
    x, y, z = v / norm(v)
    K = matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return mp.eye(3) + sin(share * a) * K + (1 - cos(share * a)) * K * K


def same_rows(groundtruth: list[State], estimate: list[State]) -> Pairs:
    """Pair equal timestamps; the cases of this rule have no others."""
    assert [g.stamp for g in groundtruth] == [e.stamp for e in estimate]
    return list(zip(groundtruth, estimate, strict=True))


def nearest(groundtruth: list[State], estimate: list[State]) -> Pairs:
    """Pair one to one within the limit, smallest time differences first."""
    candidates = sorted(
        (abs(g.stamp - e.stamp), i, j)
        for i, g in enumerate(groundtruth)
        for j, e in enumerate(estimate)
        if abs(g.stamp - e.stamp) <= LIMIT_NS
    )
    pairs: dict[int, int] = {}
    for _, i, j in candidates:
        if j not in pairs and i not in pairs.values():
            pairs[j] = i
    return [(groundtruth[pairs[j]], estimate[j]) for j in sorted(pairs)]


def linear(groundtruth: list[State], estimate: list[State]) -> Pairs:
    """Pair every estimated state with the interpolated groundtruth, not across gaps."""
    pairs = []
    for e in estimate:
        for a, b in itertools.pairwise(groundtruth):
            if a.stamp <= e.stamp <= b.stamp and b.stamp - a.stamp <= GAP_NS:
                share = mpf(e.stamp - a.stamp) / (b.stamp - a.stamp)
                R = about_axis(b.R * a.R.T, share) * a.R
                pairs.append((State(e.stamp, a.p + share * (b.p - a.p), R), e))
                break
    return pairs


Similarity = tuple[Any, Any, Any]  # s, R, t


def yaw_of(K: Any) -> Any:
    """Return the rotation about z that maximises tr(R^T K)."""
    theta = atan2(K[1, 0] - K[0, 1], K[0, 0] + K[1, 1])
    return about_axis(matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), theta * 2 / mp.pi)


def align(kind: str, pairs: Pairs, draws: random.Random | None = None) -> Similarity:
    """Return s, R, t that bring the estimate to the groundtruth: p = s R e + t.

    With draws, the sum K of Alg. 1 has random rounding errors of float64.
    """
    kind, _, first = kind.partition("_first_")
    used = pairs[: int(first)] if first else pairs
    s, R = mpf(1), mp.eye(3)
    if kind == "none":
        return s, R, matrix([0, 0, 0])
    count = len(used)
    mean_p = sum((g.p for g, _ in used), matrix([0, 0, 0])) / count
    mean_e = sum((e.p for _, e in used), matrix([0, 0, 0])) / count
    if first == "1":
        error = used[0][0].R * used[0][1].R.T
        R = error if kind == "se3" else yaw_of(error)
    elif kind != "translation":
        K = sum(((g.p - mean_p) * (e.p - mean_e).T for g, e in used), mp.zeros(3)) / count
        if draws is not None:
            step = STEP * max(abs(c) for c in K)
            K += matrix([[step * _unit(draws) for _ in range(3)] for _ in range(3)])
        if kind == "yaw":
            R = yaw_of(K)
        else:
            U, D, V = svd_r(K)
            S = diag([1, 1, 1 if det(U) * det(V) > 0 else -1])
            R = U * S * V
            if kind == "sim3":
                variance = sum(norm(e.p - mean_e) ** 2 for _, e in used) / count
                # No motion has no scale; what depends on it is listed as undetermined.
                s = sum(D[i] * S[i, i] for i in range(3)) / variance if variance else mpf(1)
    return s, R, mean_p - s * (R * mean_e)


def statistics(errors: list[mpf]) -> dict[str, mpf]:
    """Return the four statistics of errors."""
    ranked, n = sorted(errors), len(errors)
    return {
        "rmse": sqrt(sum(e * e for e in errors) / n),
        "mean": sum(errors) / n,
        "median": (ranked[(n - 1) // 2] + ranked[n // 2]) / 2,
        "max": ranked[-1],
    }


Values = Iterator[tuple[str, Any]]


def absolute(
    pairs: Pairs, draws: random.Random | None, alignments: tuple[str, ...], prefix: str = ""
) -> Values:
    """Give the absolute errors after every alignment."""
    for kind in alignments:
        if "first_10" in kind and len(pairs) < 10:
            continue
        s, R, t = align(kind, pairs, draws)
        for metric, errors in (
            ("position_m", [norm(g.p - (s * (R * e.p) + t)) for g, e in pairs]),
            ("rotation_deg", [mp.degrees(angle(g.R * (R * e.R).T)) for g, e in pairs]),
        ):
            for statistic, value in statistics(errors).items():
                if statistic == "rmse" or kind in ("none", "se3"):
                    yield f"{prefix}{metric}.{kind}.{statistic}", value
        if kind == "sim3":
            yield f"{prefix}scale.sim3", s


def path(pairs: Pairs) -> list[mpf]:
    """Return the length of the groundtruth's path up to every pair, m."""
    lengths = [mpf(0)]
    for (a, _), (b, _) in itertools.pairwise(pairs):
        lengths.append(lengths[-1] + norm(b.p - a.p))
    return lengths


def ends(along: list[Any], length: Any, every: int = 1) -> list[tuple[int, int]]:
    """Return (start, first end beyond the length) of all sub-trajectories."""
    found = []
    for start in range(0, len(along), every):
        end = next((e for e, x in enumerate(along) if x > along[start] + length), None)
        if end is not None:
            found.append((start, end))
    return found


def error_at_end(form: str, start: tuple[State, State], end: tuple[State, State]) -> Any:
    """Return the position (m) and rotation error (deg) after an alignment at the start."""
    (g0, e0), (g1, e1) = start, end
    A = align(form.removeprefix("tutorial_") + "_first_1", [start])[1]
    moved = g0.p + A * (e1.p - e0.p)
    E = g1.R * (A * e1.R).T
    difference = g1.p - (E * moved if form.startswith("tutorial") else moved)
    return norm(difference), mp.degrees(angle(E))


def relative(pairs: Pairs) -> Values:
    """Give the relative errors over 1 s and 2 m, in all forms."""
    for length, along, size in (
        ("1s", [g.stamp for g, _ in pairs], 10**9),
        ("2m", path(pairs), 2),
    ):
        for form in FORMS:
            errors = [error_at_end(form, pairs[s], pairs[e]) for s, e in ends(along, size)]
            for metric, column in zip(
                ("position_m", "rotation_deg"), zip(*errors, strict=True), strict=True
            ):
                for statistic, value in statistics(list(column)).items():
                    if statistic in ("rmse", "mean"):
                        yield f"relative.{metric}.{form}.{length}.{statistic}", value


def kitti(pairs: Pairs) -> Values:
    """Give the KITTI benchmark's t_rel (percent) and r_rel (deg/m)."""
    along, shares, rates = path(pairs), [], []
    for length in KITTI_LENGTHS:
        for start, end in ends(along, length, every=10):
            position, rotation = error_at_end("se3", pairs[start], pairs[end])
            shares.append(100 * position / length)
            rates.append(rotation / length)
    yield "kitti.t_rel_percent", sum(shares) / len(shares)
    yield "kitti.r_rel_deg_per_m", sum(rates) / len(rates)


def nees(pairs: Pairs, covariances: list[list[mpf]]) -> Values:
    """Give the mean NEES of the positions, without an alignment."""
    values = []
    for (g, e), (xx, xy, xz, yy, yz, zz) in zip(pairs, covariances, strict=True):
        error = g.p - e.p
        covariance = matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        values.append((error.T * mp.lu_solve(covariance, error))[0])
    yield "nees.position.mean", sum(values) / len(values)


RULES: dict[str, Callable[[list[State], list[State]], Pairs]] = {
    "nearest": nearest,
    "linear": linear,
}


def quantities(name: str, rows: list[Any], draws: random.Random | None = None) -> dict[str, Any]:
    """Return the values of all quantities of a case; with draws, they have rounding errors."""
    groundtruth, estimate, covariances = (
        rows if draws is None else [rounded(side, draws) for side in rows]
    )
    sides = states(groundtruth), states(estimate)
    values: dict[str, Any] = {}
    if name in ASSOCIATION_CASES:
        for rule, associate in RULES.items():
            pairs = associate(*sides)
            values[f"{rule}:pairs"] = len(pairs)
            values.update(absolute(pairs, draws, ("none", "yaw", "se3"), f"{rule}:"))
        return values
    pairs = same_rows(*sides)
    if name in RELATIVE_CASES:
        return dict(relative(pairs))
    if name in KITTI_CASES:
        return dict(kitti(pairs))
    values.update(absolute(pairs, draws, ALIGNMENTS))
    if covariances is not None:
        values.update(nees(pairs, [six for _, six in covariances]))
    return values


def rounded(rows: Any, draws: random.Random) -> Any:
    """Return rows whose coordinates differ by up to one step of float64 at the largest of them."""
    if rows is None:
        return None
    if len(rows[0][1]) == 6:
        return [(stamp, [c * (1 + _unit(draws) * STEP) for c in six]) for stamp, six in rows]
    step = max(abs(c) for _, columns in rows for c in columns[:3]) * STEP
    return [
        (
            stamp,
            [c + _unit(draws) * step for c in columns[:3]]
            + [c + _unit(draws) * STEP for c in columns[3:]],
        )
        for stamp, columns in rows
    ]


def _unit(draws: random.Random) -> mpf:
    return mpf(draws.uniform(-1, 1))


def expected(folder: Path) -> dict[str, Any]:
    """Return the content of expected.json."""
    name = folder.name
    files = [folder / f"{side}.txt" for side in ("groundtruth", "estimate", "covariance")]
    rows = [read(file) if file.exists() else None for file in files]
    values = quantities(name, rows)
    largest = max(abs(c) for side in rows[:2] for _, columns in side or () for c in columns[:3])
    draws = random.Random(name)
    changed = [quantities(name, rows, draws) for _ in range(DRAWS)]
    entries: dict[str, Any] = {}
    for quantity, value in values.items():
        if _is(quantity, UNDETERMINED.get(name, ())):
            entries[quantity] = {"value": None, "undetermined": True}
            continue
        if isinstance(value, int):
            entries[quantity] = {"value": str(value), "tolerance": 0}
        else:
            change = max(abs(other[quantity] - value) for other in changed)
            if "rotation_deg" in quantity:
                change = max(change, mp.degrees(STEP))
            elif "position_m" in quantity:
                change = max(change, STEP * largest)
            tolerance = float(max(RELATIVE * abs(value), ROUNDINGS * change))
            text = nstr(value, DIGITS, strip_zeros=False)
            entries[quantity] = {"value": text, "tolerance": _up(tolerance)}
        if _is(quantity, UNCERTAIN.get(name, ())):
            entries[quantity]["undetermined"] = True
    return {"about": ABOUT[name], "quantities": entries}


def _is(quantity: str, parts: tuple[str, ...]) -> bool:
    return any(part in quantity + "." for part in parts)


def _up(number: float) -> float:
    """Return a number with two digits, rounded up."""
    if number == 0.0:
        return 0.0
    digits = 1 - math.floor(math.log10(number))
    return float(f"{math.ceil(number * 10.0**digits) / 10.0**digits:.1e}")


def main(names: list[str]) -> None:
    """Write the expected values of these cases, or of all, and the list of hashes."""
    cases = HERE / "cases"
    for folder in sorted(cases.iterdir()):
        if not names or folder.name in names:
            text = json.dumps(expected(folder), indent=1)
            (folder / "expected.json").write_text(text + "\n", encoding="ascii")
    files = sorted(file for file in cases.rglob("*") if file.is_file())
    lines = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.relative_to(HERE).as_posix()}\n"
        for file in files
    ]
    (HERE / "SHA256SUMS").write_text("".join(lines), encoding="ascii")


if __name__ == "__main__":
    main(sys.argv[1:])
