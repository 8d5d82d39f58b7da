"""Draws figures on several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack

from trajeval_ros.batch.executors import Pool
from trajeval_ros.exceptions import InputError

Draw = Callable[[], str]
Advance = Callable[[int, int], None]
# Fewer figures are drawn faster than processes start.
_FEW = 12


def draw_all(draws: Sequence[Draw], pool: Pool, advance: Advance) -> list[str]:
    """Call functions that draw figures; return their results in order.

    Args:
        draws: Functions that draw one figure each and can be pickled.
        pool: Processes of this machine.
        advance: Called with the number of drawn figures and of all.

    Raises:
        InputError: A process died, or matplotlib is not installed.
    """
    drawn = []
    try:
        with ExitStack() as stack:
            figures: Iterable[str] = map(_draw, draws)
            if pool.workers > 1 and len(draws) > _FEW:
                executor = stack.enter_context(pool.start(pool.workers))
                figures = executor.map(_draw, draws)
            for figure in figures:
                drawn.append(figure)
                advance(len(drawn), len(draws))
    except BrokenExecutor as error:
        raise InputError(
            "a process that draws figures was killed, probably out of memory; start again with "
            "--workers 1, finished runs are kept"
        ) from error
    return drawn


def _draw(draw: Draw) -> str:
    return draw()
