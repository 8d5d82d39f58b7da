"""How much the motions of groundtruth and estimate differ, and how much they usually do."""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from trajeval_ros.geometry.arrays import Floats

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]
# Rotation, its products, lever arm, and the matrix and vector of the lever arm.
BodyState: TypeAlias = tuple[Floats | None, Floats, Floats, Floats, Floats]

CELL_S = 0.5  # time between learned pairs: shorter learns noise, longer learns late
LAGS = (1, 2, 4, 8, 16, 32, 64)  # cells between the pairs of learned differences, up to 32 s
_KEPT = 240  # learned differences of a lag: 2 min of cells
# Limit: the larger of these multiples of the median and of the 95th percentile. Six medians
# detect steps of 0.1 m of a good estimate, and report about 10 events per hour of a bad one.
_OF_MEDIAN, _OF_TAIL = 6.0, 2.5
LEAST_M, LEAST_DEG = 0.03, 2.0  # smallest limits: motion capture is not better
_LEAST_SAMPLES = 6
_FEW_SAMPLES = 60  # of the differences over one period: each of fewer changes the limit
_MEMORY_S = 60.0  # of rotation, scale and lever arm
_LEAST_FITS, _LEAST_PATH_M = 12, 1.0  # before rotation and scale are used
_OUTLIER, _OUTLIER_M = 4.0, 0.25  # a displacement of 4 times the groundtruth's is not learned
_REGULAR = 0.05  # m^2: a lever arm without rotations is zero
_GROWTH = 1.5  # exponent of the usual difference beyond the learned lags: a random walk of speed


class Pair(NamedTuple):
    """Poses of both sides at one time, seconds, metres and xyzw."""

    t: float
    groundtruth_position: Vector
    groundtruth_quaternion: Quaternion
    position: Vector
    quaternion: Quaternion


class Difference(NamedTuple):
    """What the estimate moves more or less than the groundtruth between two pairs."""

    m: float
    deg: float
    groundtruth_m: float  # the groundtruth's displacement


class _Samples:
    """The newest samples of one quantity, in order of age and of size."""

    def __init__(self) -> None:
        self._by_age: deque[float] = deque()
        self._by_size: list[float] = []

    def __len__(self) -> int:
        return len(self._by_size)

    def add(self, value: float) -> None:
        if len(self._by_age) == _KEPT:
            oldest = self._by_age.popleft()
            del self._by_size[bisect.bisect_left(self._by_size, oldest)]
        self._by_age.append(value)
        bisect.insort(self._by_size, value)

    @property
    def limit(self) -> float:
        ordered, count = self._by_size, len(self._by_size)
        tail = ordered[min(count - 1, int(0.95 * count))]
        return max(_OF_MEDIAN * ordered[count // 2], _OF_TAIL * tail)


class UsualDifferences:
    """Limits of the differences by the time between two pairs, from those of the last minutes."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        # By lag in cells; 0 is one period of the pairs. Metres and deg.
        self._samples: dict[int, tuple[_Samples, _Samples]] = {}
        # Logarithms of time and of both limits; None if they are to be computed again.
        self._table: list[tuple[float, float, float]] | None = None
        self.clear()

    def __len__(self) -> int:
        """Return the number of differences over one period."""
        return len(self._samples[0][0])

    def is_learned(self, lag: int) -> bool:
        """Return whether differences over `lag` cells are longer than a period of the pairs."""
        return lag * CELL_S > 1.5 * self._period_s

    def add(self, lag: int, difference: Difference) -> None:
        """Learn a difference over `lag` cells."""
        both = self._samples[lag]
        for samples, value in zip(both, difference[:2], strict=True):
            samples.add(value)
        # Differences over one period come often, and the other lags once per cell.
        if lag or len(both[0]) < _FEW_SAMPLES:
            self._table = None

    def clear(self) -> None:
        """Forget all differences."""
        self._samples = {lag: (_Samples(), _Samples()) for lag in (0, *LAGS)}
        self._table = None

    def limit(self, seconds: float) -> tuple[float, float]:
        """Return the largest usual difference over a time, metres and deg; infinite if unknown.

        It is interpolated between lags in logarithms.
        """
        if self._table is None:
            self._table = self._logarithms()
        table = self._table
        if not table:
            return math.inf, math.inf
        at = math.log(max(seconds, 1e-6))
        upper = bisect.bisect_left(table, (at,))
        if upper == 0:
            _, m, deg = table[0]
        elif upper == len(table):
            last, m, deg = table[-1]
            m, deg = m + _GROWTH * (at - last), deg + _GROWTH * (at - last)
        else:
            (begin, *low), (end, *high) = table[upper - 1], table[upper]
            share = (at - begin) / (end - begin)
            m, deg = (a + share * (b - a) for a, b in zip(low, high, strict=True))
        return max(math.exp(m), LEAST_M), max(math.exp(deg), LEAST_DEG)

    def _logarithms(self) -> list[tuple[float, float, float]]:
        """Return the logarithms of time and limits, which grow with the time."""
        table, largest = [], [1e-9, 1e-9]
        for lag, both in self._samples.items():
            if len(both[0]) < _LEAST_SAMPLES or (lag and not self.is_learned(lag)):
                continue
            largest = [max(a, b.limit) for a, b in zip(largest, both, strict=True)]
            time_s = lag * CELL_S if lag else self._period_s
            table.append((math.log(time_s), math.log(largest[0]), math.log(largest[1])))
        return table


class RelativeMotion:
    """Compares motions in the body, whose rotation, scale and lever arm it learns.

    The body's rotation R is that of Wahba's problem for displacements and rotation vectors: a car
    needs both. Without orientations, R rotates the estimate's frame to the groundtruth's.
    """

    def __init__(self, *, oriented: bool) -> None:
        self.oriented = oriented
        self.scale = 1.0  # metres per unit of the estimate
        self.rotation: Floats | None = None  # (3, 3); None until enough motion is known
        self.lever_m: Floats = np.zeros(3)
        self.products: Floats = np.zeros((3, 3))
        self._lever_matrix, self._lever_vector = np.zeros((3, 3)), np.zeros(3)
        self._lengths = self._squares = self._path_m = 0.0
        self._fits = 0
        self._rows: list[list[float]] = []
        self._lever: Vector = (0.0, 0.0, 0.0)

    @property
    def state(self) -> BodyState:
        """What a rotation of the body changes."""
        return (
            self.rotation,
            self.products,
            self.lever_m,
            self._lever_matrix,
            self._lever_vector,
        )

    @state.setter
    def state(self, state: BodyState) -> None:
        self.rotation, self.products, self.lever_m, *lever = state
        self._lever_matrix, self._lever_vector = lever
        self._set_scalars()

    def rotate(self, matrix: Floats) -> None:
        """Rotate the groundtruth's body by a matrix (3, 3)."""
        rotation, products, lever, lever_matrix, lever_vector = self.state
        self.state = (
            None if rotation is None else matrix @ rotation,
            matrix @ products,
            matrix @ lever,
            matrix @ lever_matrix @ matrix.T,
            matrix @ lever_vector,
        )

    def forget_frame(self) -> None:
        """Forget the rotation between frames, which a step without orientations may change."""
        self.rotation, self._fits, self._path_m = None, 0, 0.0
        self.products = np.zeros((3, 3))
        self._lengths = self._squares = 0.0

    def between(
        self, begin: Pair, end: Pair, *, by_length: bool = False, rows: Floats | None = None
    ) -> Difference:
        """Return the difference of the motions between two pairs.

        `by_length` compares lengths of displacements. `rows` is another rotation of the body.
        """
        _, p0, q0, r0, s0 = begin
        _, p1, q1, r1, s1 = end
        scale = self.scale
        d = (p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2])
        e = (scale * (r1[0] - r0[0]), scale * (r1[1] - r0[1]), scale * (r1[2] - r0[2]))
        moved_m = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        lengths_m = abs(moved_m - math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]))
        matrix = self._rows if rows is None else rows.tolist()
        is_known = self.rotation is not None or rows is not None
        if not self.oriented:
            if not is_known:
                return Difference(lengths_m, 0.0, moved_m)
            return Difference(math.dist(d, _times(matrix, e)), 0.0, moved_m)
        turned, own = _relative(q0, q1), _relative(s0, s1)
        if not is_known:
            deg = math.degrees(abs(_angle(turned) - _angle(own)))
            return Difference(lengths_m, deg, moved_m)
        x, y, z = _times(matrix, own[:3])
        deg = math.degrees(_angle(_relative(turned, (x, y, z, own[3]))))
        if by_length:
            return Difference(lengths_m, deg, moved_m)
        lever = self._lever
        # In the body at the begin and at the end: an orientation that is wrong is at one of them.
        forward = math.dist(
            _apart(_unrotated(q0, d), _times(matrix, _unrotated(s0, e))),
            _apart(_rotated(turned, lever), lever),
        )
        backward = math.dist(
            _apart(_unrotated(q1, d), _times(matrix, _unrotated(s1, e))),
            _apart(lever, _unrotated(turned, lever)),
        )
        return Difference(min(forward, backward), deg, moved_m)

    def learn(self, begin: Pair, end: Pair) -> bool:
        """Learn from a motion; return whether the rotation is known from now on."""
        scale = self.scale
        d = np.subtract(end.groundtruth_position, begin.groundtruth_position)
        e = np.subtract(end.position, begin.position)
        moved_m, own = float(np.linalg.norm(d)), float(np.linalg.norm(e))
        if self._fits > 16 and scale * own > _OUTLIER * max(moved_m, _OUTLIER_M):
            return False
        kept = math.exp(-CELL_S / _MEMORY_S) if moved_m > 0.05 else 1.0  # a hover keeps the fit
        if self.oriented:
            turned = _relative(begin.groundtruth_quaternion, end.groundtruth_quaternion)
            own_turned = _relative(begin.quaternion, end.quaternion)
            x = np.array(_unrotated(begin.groundtruth_quaternion, tuple(d)))
            y = scale * np.array(_unrotated(begin.quaternion, tuple(e)))
            vectors = _rotation_vector(turned), _rotation_vector(own_turned)
            added = np.outer(x, y) + np.outer(*vectors)
            if self.rotation is not None:
                columns = np.array([_rotated(turned, tuple(axis)) for axis in np.eye(3)]).T
                columns -= np.eye(3)
                right = columns.T @ (x - self.rotation @ y)
                self._lever_matrix = kept * self._lever_matrix + columns.T @ columns
                self._lever_vector = kept * self._lever_vector + right
        else:
            added = np.outer(d, scale * e)
        self.products = kept * self.products + added
        self._lengths = kept * self._lengths + moved_m * own
        self._squares = kept * self._squares + own * own
        self._path_m, self._fits = self._path_m + moved_m, self._fits + 1
        if self._fits < _LEAST_FITS or self._path_m <= _LEAST_PATH_M or not self._squares > 0.0:
            return False
        was_known, self.scale = self.rotation is not None, self._lengths / self._squares
        left, _, right_t = np.linalg.svd(self.products)
        # Mirrored axes are another mistake: without orientations, a reflection is allowed.
        sign = np.sign(np.linalg.det(left @ right_t)) if self.oriented else 1.0
        self.rotation = np.asarray(left @ np.diag([1.0, 1.0, sign]) @ right_t, dtype=np.float64)
        if self.oriented:
            regular = self._lever_matrix + _REGULAR * np.eye(3)
            self.lever_m = np.asarray(np.linalg.solve(regular, self._lever_vector))
        self._set_scalars()
        return not was_known

    def _set_scalars(self) -> None:
        self._rows = [] if self.rotation is None else self.rotation.tolist()
        self._lever = tuple(self.lever_m.tolist())


def rotation_beyond(motion: RelativeMotion, begin: Pair, end: Pair) -> Floats:
    """Return the matrix (3, 3) of what the groundtruth's body did not rotate as the estimate's."""
    assert motion.rotation is not None
    turned = _relative(begin.groundtruth_quaternion, end.groundtruth_quaternion)
    own = _relative(begin.quaternion, end.quaternion)
    x, y, z = _times(motion.rotation.tolist(), own[:3])
    beyond = _relative((x, y, z, own[3]), turned)
    return np.array([_rotated(beyond, tuple(axis)) for axis in np.eye(3)])


def _relative(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation from a to b, conjugate(a) b."""
    ax, ay, az, aw = -a[0], -a[1], -a[2], a[3]
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _angle(q: Quaternion) -> float:
    return 2.0 * math.atan2(math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), abs(q[3]))


def _rotation_vector(q: Quaternion) -> Floats:
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    factor = _angle(q) / length if length > 1e-9 else 2.0
    return math.copysign(factor, q[3]) * np.array(q[:3])


def _rotated(q: Quaternion, v: Sequence[float]) -> Vector:
    a, b, c, w = q
    x, y, z = v
    tx, ty, tz = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return (
        x + w * tx + b * tz - c * ty,
        y + w * ty + c * tx - a * tz,
        z + w * tz + a * ty - b * tx,
    )


def _unrotated(q: Quaternion, v: Sequence[float]) -> Vector:
    return _rotated((-q[0], -q[1], -q[2], q[3]), v)


def _times(rows: Sequence[Sequence[float]], v: Sequence[float]) -> Vector:
    (a, b, c), (d, e, f), (g, h, i) = rows
    x, y, z = v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _apart(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
