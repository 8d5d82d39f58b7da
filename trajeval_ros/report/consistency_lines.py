"""The result of a consistency test as lines of text."""

from __future__ import annotations

from trajeval_ros.consistency.result import Consistency


def consistency_lines(name: str, consistency: Consistency) -> list[str]:
    """Return the result of a consistency test as lines."""
    lines = [
        "",
        f"{name}: {consistency.verdict}; covariances from {consistency.covariance_source}, gauge "
        f"{consistency.gauge.value}",
        f"  {consistency.statement}",
    ]
    joint, per_pose = consistency.joint, consistency.per_pose
    if joint is not None:
        low, high = joint.band_95
        lines.append(
            f"  joint NEES / dof {joint.nees / joint.dof:.3f} (95 % interval of consistent runs: "
            f"{low:.3f} to {high:.3f}; {joint.dof} dof)"
        )
    if per_pose is not None:
        # Errors of one run are correlated: the interval needs a known number of effective dof.
        band = ""
        if per_pose.band_95 is not None and per_pose.effective_dof is not None:
            low, high = per_pose.band_95
            band = (
                f" (95 % interval of consistent runs: {low:.2f} to {high:.2f}; "
                f"{per_pose.effective_dof:.1f} effective of {6 * per_pose.poses} dof)"
            )
        limit = ""
        if per_pose.limit_95 is not None:
            limit = f" (95 % of consistent runs: below {per_pose.limit_95:.2f})"
        position, rotation = per_pose.position, per_pose.rotation
        lines += [
            f"  NEES / 6 of single poses: mean {per_pose.mean:.3f}{band}, largest "
            f"{per_pose.max:.3f}{limit}",
            f"  NEES / 3 of orientations: mean {rotation.mean:.3f}, largest {rotation.max:.3f}",
            f"  NEES / 3 of positions: mean {position.mean:.3f}, largest {position.max:.3f}",
        ]
        if consistency.exactness == "as published":
            lines.append(
                f"  NEES as printed by ov_eval: mean_ori = {3.0 * rotation.mean:.3f} | mean_pos "
                f"= {3.0 * position.mean:.3f}"
            )
    return lines
