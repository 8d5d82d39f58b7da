"""What can't be seen without the sources that are missing, or that give nothing."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence

from trajeval_ros.watchdog.engine import ARMING_S


def unseen(needs: Container[str], there: Container[str], notices: Sequence[str]) -> Iterator[str]:
    """Yield what can't be seen, one sentence for each source.

    Args:
        needs: The sources that were given: `twist`, `imu`, `pair`.
        there: The sources that gave signals.
        notices: What was found about the sources, which may say why one gave none.
    """
    if "twist" not in needs:
        yield "no twist: disagreement of pose and velocity is not detected"
    for need, words, what in (
        ("imu", "IMU", "yaw drift and clock slip"),
        ("pair", "second estimate", "slow divergence"),
    ):
        if need not in needs:
            yield f"no {words}: {what} not detected"
        elif need not in there and not any(words in each for each in notices):
            yield (
                f"no data of the {words} after arming ({ARMING_S:g} s of motion), so {what} not "
                "detected; check its clock"
            )
