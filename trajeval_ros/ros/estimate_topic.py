"""One estimate topic of a live run: its source, and what its segments have in common."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.sides import Side


@dataclass(frozen=True, eq=False)
class EstimateTopic:
    """What all segments of an estimate share.

    Attributes:
        side: Source of its messages.
        groundtruth: Source of the groundtruth.
        place: Index of the estimate, from 0.
        body: Transforms states to the evaluated body before they are paired.
        worker: Executor for the estimate of its clock offset.
        splits: Whether a segment ends at a jump of the estimate.
    """

    side: Side
    groundtruth: Side
    place: int
    body: MarkerBody
    worker: Executor
    splits: bool

    @property
    def description(self) -> dict[str, str | int]:
        """The topics and the index, for the pair files."""
        return {
            "groundtruth": self.groundtruth.source,
            "estimate": self.side.source,
            "place": self.place,
        }
