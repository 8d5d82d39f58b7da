"""Writes the trajectories of all cases, each from a seed that is its name.

    python make_cases.py            write cases/*/{groundtruth,estimate}.txt
    python make_expected.py         then compute cases/*/expected.json and SHA256SUMS

Another C library may round the last digit of a coordinate differently, so the expected values
belong to the files and not to this program. Standard library only.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

CASES = Path(__file__).parent / "cases"
EPOCH_NS = 1_403_636_580_000_000_000  # timestamps of a date, where float64 has 2.4e-7 s
STEP_NS = 64_000_000  # no multiple of it is 1 s: no sub-trajectory ends exactly at its length
POSES = 40

Vector = tuple[float, ...]
Quaternion = tuple[float, ...]  # xyzw
Row = tuple[int, Vector, Quaternion]


@dataclass
class Case:
    """Two lists of (timestamp in ns, position in m, orientation xyzw)."""

    groundtruth: list[Row]
    estimate: list[Row]
    covariances: list[tuple[float, ...]] | None = None  # xx xy xz yy yz zz of the estimate, m^2


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return the vector in the frame that the quaternion leads to."""
    return multiply(multiply(q, (*v, 0.0)), (-q[0], -q[1], -q[2], q[3]))[:3]


def about(axis: Vector, angle: float) -> Quaternion:
    """Return the rotation about an axis, rad."""
    norm = math.hypot(*axis)
    return (*(math.sin(angle / 2) / norm * c for c in axis), math.cos(angle / 2))


def plus(*vectors: Vector) -> Vector:
    """Return the sum."""
    return tuple(map(sum, zip(*vectors, strict=True)))


def times(factor: float, vector: Vector) -> Vector:
    """Return the product with a number."""
    return tuple(factor * c for c in vector)


class Draws(random.Random):
    """Random vectors and rotations."""

    def vector(self, size: float) -> Vector:
        """Return a normal vector of this standard deviation per axis."""
        return tuple(self.gauss(0.0, size) for _ in range(3))

    def rotation(self, angle: float) -> Quaternion:
        """Return a rotation by this angle about a random axis, rad."""
        return about(self.vector(1.0), angle)

    def walk(self, poses: int, step: float) -> list[Vector]:
        """Return positions of a random walk."""
        path = [self.vector(step)]
        while len(path) < poses:
            path.append(plus(path[-1], self.vector(step)))
        return path


def pair(
    name: str,
    *,
    poses: int = POSES,
    step: float = 0.5,
    noise: float = 0.02,
    angle: float = 0.02,
    scale: float = 1.0,
    frame: Quaternion | None = None,
    offsets: tuple[Vector, Vector] = ((0, 0, 0), (1, 2, 3)),
    shape: Callable[[int, Vector], Vector] = lambda _, p: p,
) -> Case:
    """Return a walk, and an estimate of it with noise in a frame of its own.

    Args:
        step: Standard deviation of a step per axis, m.
        noise: Standard deviation of the estimate's position per axis, m.
        angle: Rotation error of every pose, rad.
        scale: The estimate is smaller by this factor.
        frame: Rotation from the groundtruth's frame to the estimate's; by default a random yaw
            and a tilt of 0.05 rad.
        offsets: Origins of both frames, m.
        shape: Changes position i of the groundtruth.
    """
    draws = Draws(name)
    if frame is None:
        frame = multiply(about((0, 0, 1), draws.uniform(-3, 3)), about((2, 1, 0), 0.05))
    groundtruth, estimate = [], []
    for i, walked in enumerate(draws.walk(poses, step)):
        p, q = shape(i, walked), draws.rotation(draws.uniform(0, math.pi))
        stamp = EPOCH_NS + i * STEP_NS
        groundtruth.append((stamp, plus(p, offsets[0]), q))
        seen = times(1 / scale, rotate(frame, plus(p, draws.vector(noise))))
        turned = multiply(frame, multiply(draws.rotation(angle), q))
        estimate.append((stamp, plus(seen, offsets[1]), turned))
    return Case(groundtruth, estimate)


def changed(case: Case, **sides: Callable[[int, Row], Row]) -> Case:
    """Return a case with every row of a side replaced."""
    for side, change in sides.items():
        rows = getattr(case, side)
        setattr(case, side, [change(i, row) for i, row in enumerate(rows)])
    return case


LINE = (0.6, 0.64, 0.48)


def mirror(name: str) -> Case:
    """Return a nearly level walk whose heights the estimate has with the other sign."""
    case = pair(name, noise=0.0, shape=lambda _, p: (p[0], p[1], 0.05 * p[2]))
    for i, (stamp, (x, y, z), q) in enumerate(case.groundtruth):
        case.estimate[i] = (stamp, (x, y, -z), q)
    return case


def at_one_point(name: str, side: str) -> Case:
    """Return a case in which one side stays at a place, which float64 represents exactly."""
    return changed(pair(name), **{side: lambda _, row: (row[0], (1.0, 2.0, 3.0), row[2])})


def exact_line(name: str) -> Case:
    """Return two lines along axes: the rotation about them is free."""
    case = pair(name)
    steps = [float(round(64 * abs(row[1][0]))) / 64 + i for i, row in enumerate(case.groundtruth)]
    return changed(
        case,
        groundtruth=lambda i, row: (row[0], (i / 4, 0.0, 0.0), row[2]),
        estimate=lambda i, row: (row[0], (0.0, steps[i] / 4, 0.0), row[2]),
    )


def drive(name: str, poses: int) -> Case:
    """Return a drive of 10 m steps with odometry that drifts, for the errors of KITTI."""
    draws = Draws(name)
    groundtruth, estimate = [], []
    p, e = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    q = f = (0.0, 0.0, 0.0, 1.0)
    for i in range(poses):
        stamp = EPOCH_NS + i * STEP_NS
        groundtruth.append((stamp, p, q))
        estimate.append((stamp, e, f))
        length, turn = draws.uniform(8, 12), about((0, 0, 1), draws.gauss(0, 0.1))
        p, q = plus(p, rotate(q, (length, 0, 0))), multiply(q, turn)
        e = plus(e, rotate(f, plus((1.01 * length, 0, 0), draws.vector(0.05))))
        f = multiply(f, multiply(turn, draws.rotation(0.002)))
    return Case(groundtruth, estimate)


def smooth(stamp: int, origin: int = EPOCH_NS) -> tuple[Vector, Quaternion]:
    """Return the pose of a body on a smooth curve."""
    t = (stamp - origin) / 1e9
    p = (3 * math.sin(0.7 * t), 2 * math.cos(0.9 * t), math.sin(1.3 * t))
    return p, multiply(about((0, 0, 1), 0.8 * t), about((1, 0, 0), 0.4 * math.sin(t)))


def timed(
    name: str,
    groundtruth: list[int],
    estimate: list[int],
    origin: int = EPOCH_NS,
) -> Case:
    """Return both sides of the smooth curve at their timestamps, the estimate with noise."""
    draws = Draws(name)
    rows = [(stamp, *smooth(stamp, origin)) for stamp in estimate]
    return Case(
        [(stamp, *smooth(stamp, origin)) for stamp in groundtruth],
        [
            (stamp, plus(p, draws.vector(0.01)), multiply(draws.rotation(0.01), q))
            for stamp, p, q in rows
        ],
    )


def every(step_ms: float, first_ms: float, last_ms: float, origin: int = EPOCH_NS) -> list[int]:
    """Return timestamps in ns, which are whole microseconds after the origin."""
    count = int((last_ms - first_ms) / step_ms) + 1
    return [origin + 1000 * round(1000 * (first_ms + i * step_ms)) for i in range(count)]


def jittered(name: str, stamps: list[int], most_ns: int) -> list[int]:
    """Return timestamps moved by up to this."""
    draws = Draws(name + " stamps")
    return [stamp + draws.randrange(-most_ns, most_ns + 1) for stamp in stamps]


def shuffled(name: str) -> Case:
    """Return a case whose rows are in another order on both sides."""
    case = timed(name, every(50, 0, 2000), jittered(name, every(70, 11, 1990), 2_000_000))
    for side in (case.groundtruth, case.estimate):
        Draws(name + " order").shuffle(side)
    return case


def repeated(name: str) -> Case:
    """Return a case in which every fifth row occurs twice."""
    case = timed(name, every(50, 0, 2000), jittered(name, every(70, 11, 1990), 2_000_000))
    case.groundtruth = [
        row for i, row in enumerate(case.groundtruth) for _ in range(1 + (i % 5 == 0))
    ]
    case.estimate = [row for i, row in enumerate(case.estimate) for _ in range(1 + (i % 5 == 2))]
    return case


def nanoseconds(name: str) -> Case:
    """Return groundtruth of which two states are 80 to 200 ns apart, next to every estimate.

    As float64 seconds, whose step is 238 ns here, they are one timestamp or change their order.
    """
    origin = 1_700_000_000_123_456_789
    draws = Draws(name)
    middle = [origin + i * 50_000_000 for i in range(POSES)]
    groundtruth = []
    for stamp in middle:
        before, after = draws.randrange(20, 60), draws.randrange(60, 140)
        near, far = (stamp - before, stamp + after) if draws.random() < 0.5 else (
            stamp - after, stamp + before,
        )  # fmt: skip
        groundtruth += sorted((near, far))
    case = timed(name, groundtruth, middle, origin)
    # The two states are far apart in space, so a wrong pair is visible.
    return changed(
        case, groundtruth=lambda i, row: (row[0], plus(row[1], (0.5 * (i % 2), 0, 0)), row[2])
    )


def rest(name: str) -> Case:
    """Return a walk with a rest, in which the path does not grow."""
    case = pair(name, step=0.12, noise=0.01)
    still = case.groundtruth[15][1]
    return changed(
        case, groundtruth=lambda i, row: (row[0], still, row[2]) if 15 <= i < 25 else row
    )


def with_covariances(name: str) -> Case:
    """Return a case with a covariance of every position, which differs from pose to pose."""
    case = pair(name, frame=(0, 0, 0, 1), offsets=((0, 0, 0), (0, 0, 0)))
    draws = Draws(name + " covariances")
    case.covariances = []
    for _ in case.estimate:
        a, b, c = (draws.vector(0.02) for _ in range(3))
        rows = [[sum(v[i] * v[j] for v in (a, b, c)) for j in range(3)] for i in range(3)]
        case.covariances.append(tuple(
            rows[i][j] + (1e-4 if i == j else 0) for i in range(3) for j in range(i, 3)
        ))  # fmt: skip
    return case


IDENTITY = (0.0, 0.0, 0.0, 1.0)
UTM, EARTH = (5e5, 5e6, 100.0), (4e6, 3e5, 4.9e6)
RECIPES: dict[str, Callable[[str], Case]] = {
    "generic": pair,
    "same_frame": lambda n: pair(n, frame=IDENTITY, offsets=((0, 0, 0), (0, 0, 0))),
    "one_pose": lambda n: pair(n, poses=1),
    "two_poses": lambda n: pair(n, poses=2),
    "three_poses": lambda n: pair(n, poses=3, noise=0.3),
    "scale_0_37": lambda n: pair(n, scale=0.37),
    "scale_25": lambda n: pair(n, scale=25.0),
    "utm_groundtruth": lambda n: pair(n, offsets=(UTM, (1, 2, 3))),
    "utm_both": lambda n: pair(n, offsets=(UTM, (4e5, 4e6, 50.0))),
    "earth_fixed": lambda n: pair(n, noise=0.005, offsets=(EARTH, (-4e6, 1e5, 4.8e6))),
    "mirror": mirror,
    "mirrored_axis": lambda n: changed(
        pair(n), estimate=lambda _, row: (row[0], (row[1][0], -row[1][1], row[1][2]), row[2])
    ),
    "plane": lambda n: pair(n, noise=0.01, shape=lambda _, p: (p[0], p[1], 0.0)),
    "turned_frame": lambda n: pair(n, frame=about((1, 2, 3), 2.0)),
    "yaw_near_180_deg": lambda n: pair(n, frame=about((0, 0, 1), math.pi - 1e-9)),
    "near_line": lambda n: pair(n, noise=0.001, shape=lambda i, p: plus(
        times(i / 4, LINE), times(0.001, p))),
    "exact_line": exact_line,
    "motionless_estimate": lambda n: at_one_point(n, "estimate"),
    "motionless_groundtruth": lambda n: at_one_point(n, "groundtruth"),
    "micrometres": lambda n: pair(n, step=1e-7, noise=5e-9, offsets=((0, 0, 0), (0, 0, 0))),
    "megametres": lambda n: pair(n, step=1e5, noise=10.0),
    "no_noise": lambda n: pair(n, noise=0.0, angle=1e-12),
    "rotation_1e-8_rad": lambda n: pair(
        n, angle=1e-8, frame=IDENTITY, offsets=((0, 0, 0), (0, 0, 0))
    ),
    "rotation_near_180_deg": lambda n: pair(n, angle=math.pi - 1e-9, frame=IDENTITY),
    "quaternion_signs": lambda n: changed(
        pair(n), estimate=lambda i, row: (*row[:2], times(-1 if i % 3 else 1, row[2]))
    ),
    "quaternions_not_normalised": lambda n: changed(
        pair(n),
        groundtruth=lambda i, row: (*row[:2], times(1 + 1e-3 * (i % 7), row[2])),
        estimate=lambda i, row: (*row[:2], times(1 - 1e-3 * (i % 5), row[2])),
    ),
    "one_outlier": lambda n: changed(
        pair(n), estimate=lambda i, row: (row[0], plus(row[1], (300.0 * (i == 27), 0, 0)), row[2])
    ),
    "negative_zero": lambda n: changed(
        pair(n, frame=IDENTITY),
        groundtruth=lambda _, row: (row[0], (*row[1][:2], -0.0), row[2]),
        estimate=lambda _, row: (row[0], (*row[1][:2], -0.0), row[2]),
    ),
    "text_forms": pair,
    "keyframes": lambda n: timed(
        n, *2 * [[EPOCH_NS + 1_000_000 * (97 * i * i % 1500 + 1500 * i) for i in range(20)]]
    ),
    "slow_estimate": lambda n: timed(
        n, every(25, 0, 2000), jittered(n, every(97, 3.1, 1990), 2_000_000)
    ),
    "fast_estimate": lambda n: timed(
        n, jittered(n, every(50, 0, 2000), 1_000_000), every(12.3, 5, 1000)
    ),
    "near_the_limit": lambda n: timed(n, every(100, 0, 3900), [
        EPOCH_NS + i * 100_000_000 + (-1) ** i * (19_900_000 + 200_000 * (i % 3 == 0))
        for i in range(1, 39)
    ]),
    "unsorted": shuffled,
    "repeated_rows": repeated,
    "gap_of_groundtruth": lambda n: timed(
        n, every(50, 0, 700) + every(50, 1900, 2600), jittered(n, every(70, 11, 2590), 2_000_000)
    ),
    "gap_of_estimate": lambda n: timed(
        n, every(50, 0, 2600), jittered(n, every(70, 11, 700) + every(70, 1900, 2590), 2_000_000)
    ),
    "partial_overlap": lambda n: timed(
        n, every(50, 0, 2000), jittered(n, every(70, -511, 2490), 2_000_000)
    ),
    "shortest_rotation": lambda n: changed(
        timed(n, every(50, 0, 2000), jittered(n, every(70, 11, 1990), 2_000_000)),
        groundtruth=lambda i, row: (*row[:2], times(-1 if i % 2 else 1, row[2])),
    ),
    "nanoseconds": nanoseconds,
    "relative_walk": lambda n: pair(n, step=0.12, noise=0.01),
    "relative_rest": rest,
    "relative_utm": lambda n: pair(n, step=0.12, noise=0.01, offsets=(UTM, (4e5, 4e6, 50.0))),
    "kitti_drive": lambda n: drive(n, 140),
    "kitti_short_drive": lambda n: drive(n, 45),
    "nees": with_covariances,
}  # fmt: skip


def stamp_text(stamp: int) -> str:
    """Return seconds with nine decimals, exactly."""
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"


def line(row: Row) -> str:
    """Return `timestamp tx ty tz qx qy qz qw`; 17 digits restore any float64."""
    return " ".join([stamp_text(row[0]), *(f"{c:.17g}" for c in (*row[1], *row[2]))])


def in_other_forms(lines: list[str]) -> str:
    """Return the same rows with what readers meet: comments, tabs, empty lines, CR LF."""
    marked = ["# timestamp tx ty tz qx qy qz qw", "", *lines]
    marked[5] = "  " + marked[5].replace(" ", "\t") + "  "
    marked[7] = " ".join(
        word if i == 0 else f"{float(word):+.17e}" for i, word in enumerate(marked[7].split())
    )
    marked.insert(9, "# a comment between rows")
    return "\r\n".join(marked)  # and none at the end


def main() -> None:
    """Write all cases."""
    for name, recipe in RECIPES.items():
        case, folder = recipe(name), CASES / name
        folder.mkdir(parents=True, exist_ok=True)
        for side in ("groundtruth", "estimate"):
            lines = [line(row) for row in getattr(case, side)]
            text = in_other_forms(lines) if name == "text_forms" else "\n".join(lines) + "\n"
            (folder / f"{side}.txt").write_text(text, encoding="ascii", newline="")
        if case.covariances is not None:
            rows = zip(case.estimate, case.covariances, strict=True)
            text = "".join(
                " ".join([stamp_text(row[0]), *(f"{c:.17g}" for c in six)]) + "\n"
                for row, six in rows
            )
            (folder / "covariance.txt").write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
