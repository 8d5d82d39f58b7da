"""Computes all quantities a second time, by other formulas, as a check of the expected values.

    python independent.py > independent.json
    python score.py --relative 1e-12 independent.json

make_expected.py uses matrices and a singular value decomposition. Here everything is quaternions:
the alignment is Horn's largest eigenvalue (1987), slerp is the formula of sines, and errors are
angles of quaternion products. Needs mpmath; imports nothing of the kit.
"""

from __future__ import annotations

import itertools
import json
import sys
from fractions import Fraction
from pathlib import Path

import mpmath
from mpmath import mpf

mpmath.mp.dps = 70
CASES = Path(__file__).parent / "cases"


def number(text):
    """Return a decimal text as an exact fraction, rounded once to 70 digits."""
    exact = Fraction(text)
    return mpf(exact.numerator) / exact.denominator


def load(file):
    """Return [ns, x, y, z, qx, qy, qz, qw] rows: sorted, without repetitions, quaternions unit."""
    rows = {}
    for line in file.read_text().replace("\r", "\n").split("\n"):
        fields = line.split("#")[0].split()
        if fields:
            stamp, p, q = int(Fraction(fields[0]) * 1000000000), fields[1:4], fields[4:]
            q = [number(item) for item in q]
            length = mpmath.sqrt(mpmath.fdot(q, q))
            if stamp not in rows:
                rows[stamp] = [stamp, [number(item) for item in p], [c / length for c in q]]
    return [rows[stamp] for stamp in sorted(rows)]


def product(a, b):
    """Return the quaternion product, vector part first."""
    u, s, v, t = a[:3], a[3], b[:3], b[3]
    c = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    return [s * v[k] + t * u[k] + c[k] for k in range(3)] + [s * t - mpmath.fdot(u, v)]


def inverse(q):
    """Return the conjugate of a unit quaternion."""
    return [-q[0], -q[1], -q[2], q[3]]


def rotated(q, v):
    """Return q v q^-1."""
    return product(product(q, [*v, mpf(0)]), inverse(q))[:3]


def angle_deg(q):
    """Return the angle of a unit quaternion of either sign."""
    half = mpmath.atan2(mpmath.sqrt(mpmath.fdot(q[:3], q[:3])), abs(q[3]))
    return half * 360 / mpmath.pi


def minus(a, b):
    """Return the difference of two vectors."""
    return [x - y for x, y in zip(a, b, strict=False)]


def size(v):
    """Return the length of a vector."""
    return mpmath.sqrt(mpmath.fdot(v, v))


def mean(vectors):
    """Return the mean of vectors."""
    return [mpmath.fsum(column) / len(vectors) for column in zip(*vectors, strict=False)]


def slerp(a, b, share):
    """Return the rotation between two, on the shorter way."""
    cosine = mpmath.fdot(a, b)
    if cosine < 0:
        b, cosine = [-c for c in b], -cosine
    theta = mpmath.acos(min(cosine, mpf(1)))
    if theta == 0:
        return a
    x, y = mpmath.sin((1 - share) * theta), mpmath.sin(share * theta)
    return [(x * c + y * d) / mpmath.sin(theta) for c, d in zip(a, b, strict=False)]


def by_time(true, other):
    """Give the estimated states with the groundtruth between its neighbours."""
    out = []
    for stamp, p, q in other:
        before = [k for k, row in enumerate(true) if row[0] <= stamp]
        after = [k for k, row in enumerate(true) if row[0] >= stamp]
        if not before or not after:
            continue
        a, b = true[before[-1]], true[after[0]]
        width = b[0] - a[0]
        if 2 * width > 1000000000:
            continue
        share = mpf(stamp - a[0]) / width if width else mpf(0)
        between = [x + (y - x) * share for x, y in zip(a[1], b[1], strict=False)]
        out.append((stamp, between, slerp(a[2], b[2], share), p, q))
    return out


def by_distance(true, other):
    """Take the closest two timestamps again and again, until none are within 20 ms."""
    left, right, out = set(range(len(true))), set(range(len(other))), []
    while left and right:
        best = min((abs(true[i][0] - other[j][0]), i, j) for i in left for j in right)
        if best[0] > 20000000:
            break
        _, i, j = best
        left.remove(i)
        right.remove(j)
        out.append((other[j][0], true[i][1], true[i][2], other[j][1], other[j][2]))
    return sorted(out, key=lambda pair: pair[0])


def heading(q):
    """Return the nearest rotation about z."""
    length = mpmath.sqrt(q[2] ** 2 + q[3] ** 2)
    return [mpf(0), mpf(0), q[2] / length, q[3] / length] if length else [mpf(0)] * 3 + [mpf(1)]


def horn(a, b):
    """Return the rotation that brings centred points b to a, by Horn's matrix."""
    S = [
        [mpmath.fsum(y[i] * x[j] for x, y in zip(a, b, strict=False)) for j in range(3)]
        for i in range(3)
    ]
    N = mpmath.matrix(
        [
            [S[0][0] + S[1][1] + S[2][2], S[1][2] - S[2][1], S[2][0] - S[0][2], S[0][1] - S[1][0]],
            [S[1][2] - S[2][1], S[0][0] - S[1][1] - S[2][2], S[0][1] + S[1][0], S[2][0] + S[0][2]],
            [S[2][0] - S[0][2], S[0][1] + S[1][0], S[1][1] - S[0][0] - S[2][2], S[1][2] + S[2][1]],
            [S[0][1] - S[1][0], S[2][0] + S[0][2], S[1][2] + S[2][1], S[2][2] - S[0][0] - S[1][1]],
        ]
    )
    scale = max(abs(item) for item in N)
    if scale == 0:
        return [mpf(0), mpf(0), mpf(0), mpf(1)]
    values, vectors = mpmath.eigsy(N / scale)
    best = max(range(4), key=lambda k: values[k])
    w, x, y, z = (vectors[k, best] for k in range(4))
    return [x, y, z, w]


def fit(kind, pairs):
    """Return scale, rotation, and the two points that coincide after the alignment."""
    if kind == "none":
        return mpf(1), [mpf(0)] * 3 + [mpf(1)], [mpf(0)] * 3, [mpf(0)] * 3
    name, _, limit = kind.partition("_first_")
    pairs = pairs[: int(limit)] if limit else pairs
    center, middle = mean([pair[1] for pair in pairs]), mean([pair[3] for pair in pairs])
    if limit == "1":
        turn = product(pairs[0][2], inverse(pairs[0][4]))
        return mpf(1), turn if name == "se3" else heading(turn), center, middle
    a = [minus(pair[1], center) for pair in pairs]
    b = [minus(pair[3], middle) for pair in pairs]
    if name == "translation":
        return mpf(1), [mpf(0)] * 3 + [mpf(1)], center, middle
    if name == "yaw":
        x = mpmath.fsum(p[0] * e[0] + p[1] * e[1] for p, e in zip(a, b, strict=False))
        y = mpmath.fsum(p[1] * e[0] - p[0] * e[1] for p, e in zip(a, b, strict=False))
        half = mpmath.atan2(y, x) / 2
        return mpf(1), [mpf(0), mpf(0), mpmath.sin(half), mpmath.cos(half)], center, middle
    turn = horn(a, b)
    if name == "se3":
        return mpf(1), turn, center, middle
    total = mpmath.fsum(mpmath.fdot(e, e) for e in b)
    along = mpmath.fsum(mpmath.fdot(p, rotated(turn, e)) for p, e in zip(a, b, strict=False))
    return (along / total if total else mpf(1)), turn, center, middle


def summary(out, name, values, only=("rmse", "mean", "median", "max")):
    """Store the statistics of values."""
    values = sorted(values)
    count = len(values)
    every = {
        "rmse": mpmath.sqrt(mpmath.fsum(values, squared=True) / count),
        "mean": mpmath.fsum(values) / count,
        "median": mpmath.fsum(values[(count - 1) // 2 : count // 2 + 1]) / (2 - count % 2),
        "max": max(values),
    }
    for statistic in only:
        out[f"{name}.{statistic}"] = every[statistic]


def ate(out, pairs, kinds, prefix=""):
    """Store the absolute errors."""
    for kind in kinds:
        if kind.endswith("10") and len(pairs) < 10:
            continue
        s, turn, center, middle = fit(kind, pairs)
        position, rotation = [], []
        for _, p, q, e, f in pairs:
            moved = [s * c for c in rotated(turn, minus(e, middle))]
            position.append(size(minus(minus(p, center), moved)))
            rotation.append(angle_deg(product(q, inverse(product(turn, f)))))
        only = ("rmse", "mean", "median", "max") if kind in ("none", "se3") else ("rmse",)
        summary(out, f"{prefix}position_m.{kind}", position, only)
        summary(out, f"{prefix}rotation_deg.{kind}", rotation, only)
        if kind == "sim3":
            out[f"{prefix}scale.sim3"] = s


def lengths(pairs):
    """Return the path up to every pair."""
    total, out = mpf(0), [mpf(0)]
    for before, after in itertools.pairwise(pairs):
        total += size(minus(after[1], before[1]))
        out.append(total)
    return out


def later(along, start, length):
    """Return the first index beyond a length, or None."""
    for k in range(start, len(along)):
        if along[k] - along[start] > length:
            return k
    return None


def at_end(a, b, form):
    """Return both errors at b of a sub-trajectory that is aligned at a."""
    turn = product(a[2], inverse(a[4]))
    if form.endswith("yaw"):
        turn = heading(turn)
    moved = rotated(turn, minus(b[3], a[3]))
    error = product(b[2], inverse(product(turn, b[4])))
    if form.startswith("tutorial"):
        aligned = [x + y for x, y in zip(a[1], moved, strict=False)]
        difference = minus(b[1], rotated(error, aligned))
    else:
        difference = minus(minus(b[1], a[1]), moved)
    return size(difference), angle_deg(error)


def re(out, pairs):
    """Store the relative errors."""
    for name, along, limit in (
        ("1s", [pair[0] for pair in pairs], 1000000000),
        ("2m", lengths(pairs), 2),
    ):
        chosen = [(k, later(along, k, limit)) for k in range(len(pairs))]
        for form in ("se3", "yaw", "tutorial_se3", "tutorial_yaw"):
            errors = [at_end(pairs[s], pairs[e], form) for s, e in chosen if e is not None]
            for metric, k in (("position_m", 0), ("rotation_deg", 1)):
                column = [error[k] for error in errors]
                summary(out, f"relative.{metric}.{form}.{name}", column, ("rmse", "mean"))


def benchmark(out, pairs):
    """Store KITTI's translation and rotation errors."""
    along, position, rotation = lengths(pairs), [], []
    for start in range(0, len(pairs), 10):
        for length in range(100, 900, 100):
            end = later(along, start, length)
            if end is not None:
                metres, degrees = at_end(pairs[start], pairs[end], "se3")
                position.append(metres / length)
                rotation.append(degrees / length)
    out["kitti.t_rel_percent"] = 100 * mpmath.fsum(position) / len(position)
    out["kitti.r_rel_deg_per_m"] = mpmath.fsum(rotation) / len(rotation)


def squared(out, pairs, file):
    """Store the NEES, by the inverse of a symmetric matrix from its cofactors."""
    values = []
    for pair, line in zip(pairs, file.read_text().splitlines(), strict=False):
        a, b, c, d, e, f = (number(text) for text in line.split()[1:])
        x, y, z = minus(pair[1], pair[3])
        determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
        form = x * x * (d * f - e * e) + y * y * (a * f - c * c) + z * z * (a * d - b * b)
        form += 2 * (x * y * (c * e - b * f) + x * z * (b * e - c * d) + y * z * (b * c - a * e))
        values.append(form / determinant)
    out["nees.position.mean"] = mpmath.fsum(values) / len(values)


def case(folder):
    """Return all quantities of a case."""
    true, other = load(folder / "groundtruth.txt"), load(folder / "estimate.txt")
    out = {}
    if [row[0] for row in true] != [row[0] for row in other]:
        for rule, pairs in (
            ("nearest", by_distance(true, other)),
            ("linear", by_time(true, other)),
        ):
            out[f"{rule}:pairs"] = len(pairs)
            ate(out, pairs, ("none", "yaw", "se3"), f"{rule}:")
        return out
    pairs = [(a[0], a[1], a[2], b[1], b[2]) for a, b in zip(true, other, strict=False)]
    if folder.name.startswith("relative"):
        re(out, pairs)
    elif folder.name.startswith("kitti"):
        benchmark(out, pairs)
    else:
        ate(
            out, pairs, ["none", "translation", "yaw", "se3", "sim3", "yaw_first_1", "se3_first_1"]
        )
        ate(out, pairs, ("yaw_first_10", "se3_first_10"))
        if (folder / "covariance.txt").exists():
            squared(out, pairs, folder / "covariance.txt")
    return out


def main():
    """Print the results as JSON, with 40 digits."""
    results = {}
    for folder in sorted(path for path in CASES.iterdir() if path.is_dir()):
        expected = json.loads((folder / "expected.json").read_text())["quantities"]
        results[folder.name] = {
            # No formula shows that a value is arbitrary, so these are taken from the list.
            key: "undetermined" if expected[key]["value"] is None else mpmath.nstr(value, 40)
            for key, value in case(folder).items()
        }
    json.dump({"tool": "independent", "version": "", "results": results}, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
