"""Faults that are not detected, because sources are missing or have no data."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from trajeval_ros.watchdog.engine import ARMING_S
from trajeval_ros.watchdog.signals import PAIR, source_words

_SEES = {"imu": "yaw drift and clock slip", PAIR: "slow divergence", "map": "map corrections"}


def unseen(
    needs: Collection[str], there: Collection[str], notices: Sequence[str]
) -> Iterator[str]:
    """Yield one sentence per source whose faults are not detected.

    Args:
        needs: The sources that were given: `twist`, `imu`, `pair`, `pair.NAME`, `map`.
        there: The sources with signals.
        notices: Findings about the sources. A source that they name has no further sentence.
    """
    if "twist" not in needs:
        yield "no twist: disagreement of pose and velocity is not detected"
    kinds = {each.partition(".")[0] for each in needs}
    for kind in ("imu", PAIR):
        if kind not in kinds:
            yield f"no {source_words(kind)}: {_SEES[kind]} not detected"
    for each in sorted(set(needs) - {"twist"} - set(there)):
        words = source_words(each)
        if not any(words in notice for notice in notices):
            yield (
                f"no data of the {words} after arming ({ARMING_S:g} s of motion), so "
                f"{_SEES[each.partition('.')[0]]} not detected; check its clock"
            )
