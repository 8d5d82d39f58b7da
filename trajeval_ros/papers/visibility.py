"""Which landmarks are observed from which keyframes, and sums over observations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices

# A landmark with one view has an unknown depth and adds a null direction. Two views are the
# minimum, but determine the depth poorly if the keyframes are close.
FEWEST_VIEWS = 3
# Shortest windows: with shorter ones, calls cost more time than products.
_FEWEST_STARTS = 8


@dataclass(frozen=True, eq=False)
class LandmarkWindow:
    """Landmarks of similar tracks that start near each other, and the tracks' keyframes."""

    first: int  # first of the n keyframes
    last: int  # the keyframe after the last one
    landmarks: int  # number k of landmarks
    observations: Indices  # (m,), the landmarks' observations
    rows: Indices  # (m,), keyframes of the observations, counted from `first`
    columns: Indices  # (m,), landmarks of the observations, counted in the window

    @property
    def keyframes(self) -> int:
        """Number n of keyframes."""
        return self.last - self.first

    def dense(self, blocks: Floats) -> Floats:
        """Return the blocks (a, b, M) of all observations as the window's matrix (a n, b k).

        Rows are by keyframe. Columns are by column of the blocks, and then by landmark.
        """
        rows, columns, _ = blocks.shape
        matrix = np.zeros((self.keyframes, rows, columns * self.landmarks))
        places = self.landmarks * np.arange(columns)[:, None] + self.columns
        matrix.swapaxes(0, 1)[:, self.rows, places] = blocks.take(self.observations, axis=-1)
        return matrix.reshape(rows * self.keyframes, -1)


class Sums:
    """Sums over the observations of each group, a keyframe or a landmark."""

    def __init__(self, group_of: Indices, groups: int) -> None:
        """Store the groups (M,) of the observations."""
        self._groups = groups
        self._order = np.argsort(group_of, kind="stable")
        self._observed, self._starts = np.unique(group_of[self._order], return_index=True)

    def __call__(self, values: Floats) -> Floats:
        """Return the sums (..., groups) of values (..., M); 0 for a group without observations."""
        sums = np.zeros((*values.shape[:-1], self._groups))
        ordered = values.take(self._order, axis=-1)
        sums[..., self._observed] = np.add.reduceat(ordered, self._starts, axis=-1)
        return sums


class Visibility:
    """M observations of K landmarks from N keyframes, in any order."""

    def __init__(
        self, keyframe_of: Indices, landmark_of: Indices, keyframes: int, landmarks: int
    ) -> None:
        """Store the keyframes (M,) and landmarks (M,) of the observations."""
        self.keyframe_of, self.landmark_of = keyframe_of, landmark_of
        self.keyframes, self.landmarks = keyframes, landmarks
        # Sums over the observations of each keyframe.
        self.by_keyframe = Sums(keyframe_of, keyframes)
        # Sums over the observations of each landmark.
        self.by_landmark = Sums(landmark_of, landmarks)
        first = np.full(landmarks, keyframes)
        last = np.full(landmarks, -1)
        np.minimum.at(first, landmark_of, keyframe_of)
        np.maximum.at(last, landmark_of, keyframe_of)
        # The IMU couples two keyframes.
        # Largest number of keyframes from a landmark's first to its last, at least 2.
        self.longest_track = max(int((last - first).max()) + 1, 2)
        self.windows = list(self._windows(first, last))  # all landmarks, by windows of keyframes

    def _windows(self, first: Indices, last: Indices) -> Iterator[LandmarkWindow]:
        # Tracks of up to 8, 16, 32, ... keyframes that begin within as many: a product has few
        # zeros, and a long track does not widen the windows of others.
        lengths = np.maximum((last - first + 1) / _FEWEST_STARTS, 1.0)
        starts = _FEWEST_STARTS << np.ceil(np.log2(lengths)).astype(np.int64)
        starts[2 * starts > self.keyframes] = self.keyframes
        window_of = (starts * self.keyframes + first // starts)[self.landmark_of]
        order = np.argsort(window_of, kind="stable")
        ends = np.flatnonzero(np.diff(window_of[order])) + 1
        for observations in np.split(order, ends):
            landmarks, columns = np.unique(self.landmark_of[observations], return_inverse=True)
            begin, end = int(first[landmarks].min()), int(last[landmarks].max()) + 1
            rows = self.keyframe_of[observations] - begin
            yield LandmarkWindow(begin, end, len(landmarks), observations, rows, columns)
