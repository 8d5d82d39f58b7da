"""Jumps of one segment of an estimate, which may end the segment."""

from __future__ import annotations

from copy import copy

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.online.jump_detector import Jump, JumpDetector
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_rows import Pairs


class SegmentJumps:
    """Detects the jumps among the pairs of a segment.

    Attributes:
        following: Pairing of the next segment, if this one ended with a jump.
    """

    def __init__(self, *, splits: bool, before: SegmentJumps | None = None) -> None:
        """Create it without a pair.

        Args:
            splits: Whether the segment ends at its first jump.
            before: The jumps of the previous segment.
        """
        self.following: Pairing | None = None
        self._splits = splits
        self._detector, self._found = JumpDetector(), list[Jump]()
        if before is not None:
            self._found = before._found
            if before.following is not None:
                self._detector = before._detector  # keeps the usual step size

    @property
    def count(self) -> int:
        """Number of jumps in the segment so far."""
        return self._detector.count

    def before_first(self, pairs: Pairs, scale: float, buffer: Pairing) -> Pairs:
        """Return new pairs up to the first jump; later ones belong to the next segment.

        All pairs are returned if jumps do not end the segment.

        Args:
            pairs: The pairs that `buffer` has just made.
            scale: Scale of the present alignment.
            buffer: Pairing of the segment, which a jump ends.
        """
        if not self._splits or not len(pairs.stamps):
            return pairs
        narrowed, detector = pairs.without_covariances(), copy(self._detector)
        found = detector.update(narrowed, scale)
        if not found:
            self._detector = detector
            return pairs
        row = int(pairs.stamps.searchsorted(found[0].stamp))
        self._found = self._detector.update(narrowed.picked(slice(row + 1)), scale)
        self._detector.count = 0  # a segment contains no jump
        pairs, self.following = buffer.cut(pairs, row)
        return pairs

    def among(self, pairs: Pairs, scale: float) -> None:
        """Detect jumps among pairs that `before_first` has passed, if they do not end segments."""
        if not self._splits:
            self._found = [*self._found, *self._detector.update(pairs, scale)]

    def take(self) -> list[Jump]:
        """Return the jumps that were detected since the last call."""
        found, self._found = self._found, []
        return found


def about_jump(name: str, jump: Jump) -> Notice:
    """Return the notice about a jump of an estimate, by the estimate's name."""
    said = (
        f"{name} jumps by {jump.position_m:.2f} m and {jump.rotation_deg:.0f} deg at "
        f"{jump.stamp / NANOSECONDS:.3f} s: probably a restart with a new origin, which one "
        "alignment can't fit; to start a new run, call ~/reset"
    )
    values = {
        "stamp_ns": jump.stamp,
        "position_m": jump.position_m,
        "rotation_deg": jump.rotation_deg,
    }
    return Notice("jump", WARN, said, values=values)
