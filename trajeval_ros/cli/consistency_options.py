"""From the words of the command line to the consistency of an evaluated run."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import InputError, SettingsError

if TYPE_CHECKING:
    from trajeval_ros.consistency.judgement import Aligned
    from trajeval_ros.consistency.result import Consistency
    from trajeval_ros.metrics.evaluation import Evaluation

FRAMES = ("world", "body")
NONE, MESSAGE = "none", "message"


@dataclasses.dataclass(frozen=True)
class CovarianceSettings:
    """Where covariances come from, and what they are of.

    Attributes:
        source: `none`, `message`, or the path of a joint covariance.
        body_frame: Whether messages hold rotation errors about the body's axes.
        groundtruth_noise: Standard deviations of groundtruth positions (m) and rotations (deg).
    """

    source: str = NONE
    body_frame: bool = False
    groundtruth_noise: tuple[float, float] | None = None

    @classmethod
    def parse(
        cls, source: str, frame: str, noise: str | None, *, continuous: bool = False
    ) -> CovarianceSettings:
        """Read `--covariance`, `--rotation-covariance-frame` and `--groundtruth-noise`.

        Args:
            source: Of the covariances.
            frame: Of the messages' rotation covariances.
            noise: Of the groundtruth's samples.
            continuous: Whether the association asks for the noise, too.

        Raises:
            SettingsError: They mean nothing, or nothing together.
        """
        if frame not in FRAMES:
            raise SettingsError(
                f"there is no rotation covariance frame {frame!r}; use world, or body for "
                "OpenVINS and others that perturb rotations on the right"
            )
        if noise is not None and source == NONE and not continuous:
            raise SettingsError(
                "--groundtruth-noise is for likelihoods and for the consistency of covariances; "
                "add --covariance message, --covariance FILE.npz or --association continuous"
            )
        if continuous and source != NONE:
            raise SettingsError(
                "--covariance judges against samples of the groundtruth, and association "
                "continuous also where there are none; use association linear or nearest"
            )
        if frame == "body" and source != MESSAGE:
            raise SettingsError(
                "--rotation-covariance-frame body is about covariances in messages; add "
                "--covariance message (a joint file says itself how rotations are perturbed)"
            )
        return cls(source, frame == "body", None if noise is None else parse_noise(noise))

    @property
    def from_messages(self) -> bool:
        """Whether the estimate's messages have to be read with their covariances."""
        return self.source == MESSAGE

    def judge(self, evaluation: Evaluation) -> Consistency | None:
        """Judge an evaluated run; None if nobody asked.

        Raises:
            InputError: Covariances that say nothing, or are of other poses.
            SettingsError: An alignment that covariances can't be brought to.
            DegenerateGeometryError: States that don't determine the alignment.
        """
        if self.source == NONE:
            return None
        from trajeval_ros.consistency.judgement import judge_joint, judge_marginals

        aligned = self._aligned(evaluation)
        if self.source == MESSAGE:
            first = evaluation.association.estimate.stamps[0]
            offset = round(evaluation.protocol.association.time_offset_s * 1e9)
            at_start = bool(first - offset == evaluation.estimate.stamps[0])
            return judge_marginals(aligned, from_the_start=at_start)
        from trajeval_ros.io.covariance_file import read_joint_covariance

        path = Path(self.source)
        covariance = read_joint_covariance(path)
        try:
            return judge_joint(aligned, covariance, path.name)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    def _aligned(self, evaluation: Evaluation) -> Aligned:
        import numpy as np

        from trajeval_ros.consistency.judgement import Aligned
        from trajeval_ros.consistency.marginal_covariances import about_world_axes
        from trajeval_ros.geometry import lie

        protocol, pairs = evaluation.protocol, evaluation.association
        if protocol.align_weights != NONE:
            raise SettingsError(
                "consistency knows no alignment that is weighted by covariances; use align "
                "weights none"
            )
        if evaluation.alignment.undetermined:
            why = evaluation.alignment.undetermined
            raise InputError(f"no covariance can be brought into this gauge: {why}")
        estimate = pairs.estimate
        offset = round(protocol.association.time_offset_s * 1e9)
        estimate = dataclasses.replace(estimate, stamps=estimate.stamps - offset)
        if self.body_frame and estimate.covariances is not None:
            if estimate.quaternions is None:
                raise InputError("the estimate has no orientations to turn its covariances by")
            turned = about_world_axes(estimate.covariances, lie.to_matrix(estimate.quaternions))
            estimate = dataclasses.replace(estimate, covariances=turned)
        variances = None
        if self.groundtruth_noise is not None:
            position_m, rotation_deg = self.groundtruth_noise
            sigmas = [position_m] * 3 + [math.radians(rotation_deg)] * 3
            variances = np.square(sigmas)
        return Aligned(
            groundtruth=pairs.groundtruth,
            estimate=estimate,
            similarity=evaluation.alignment.similarity,
            gauge=protocol.gauge,
            states=protocol.align_states,
            variances=variances,
        )


def parse_noise(text: str) -> tuple[float, float]:
    """Read "0.002,0.1": metres and degrees."""
    try:
        position_m, rotation_deg = (float(part) for part in text.split(","))
    except ValueError:
        position_m = rotation_deg = math.nan
    if min(position_m, rotation_deg) <= 0.0:
        raise SettingsError(
            f"the groundtruth noise must be above zero, not {text}: against groundtruth that is "
            "exactly right, every error is infinitely unlikely"
        )
    if not (position_m < math.inf and rotation_deg < math.inf):
        raise SettingsError(
            f"can't read the groundtruth noise {text!r}; write standard deviations in metres and "
            "degrees, as in --groundtruth-noise 0.002,0.1"
        )
    return position_m, rotation_deg
