"""A period in which the estimate did not follow the groundtruth."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.geometry.trajectory import NANOSECONDS

FROZEN, DIVERGED = "frozen", "diverged"


@dataclass(frozen=True)
class Loss:
    """A period in which the estimate did not follow the groundtruth."""

    cause: str  # `frozen` or `diverged`
    begin_ns: int  # timestamp of the last pair before it
    end_ns: int  # timestamp of the last pair of it so far
    true_m: float  # path of the groundtruth since the begin; if frozen, the largest distance
    true_deg: float  # if frozen, the largest rotation of the groundtruth; else 0
    moved_m: float  # path of the estimate since the begin, in the groundtruth's unit
    is_error: bool  # whether it is long or large enough for an error
    is_over: bool  # whether the estimate has followed again

    @classmethod
    def beginning(cls, cause: str, begin_ns: int) -> Loss:
        """Return a loss without a duration."""
        return cls(cause, begin_ns, begin_ns, 0.0, 0.0, 0.0, is_error=False, is_over=False)

    @property
    def duration_s(self) -> float:
        """Its duration so far, seconds."""
        return (self.end_ns - self.begin_ns) / NANOSECONDS
