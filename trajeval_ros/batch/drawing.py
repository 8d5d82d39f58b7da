"""Draws the figures of a report, which takes longer than evaluating: on several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack
from dataclasses import dataclass

from trajeval_ros.batch.executors import Pool
from trajeval_ros.exceptions import InputError

Draw = Callable[[], str]
Advance = Callable[[int, int], None]
# As many are drawn in the time that processes take to start.
_FEW = 12


@dataclass(frozen=True)
class FigureDraft:
    """A figure that is yet to be drawn.

    Attributes:
        title: In few words.
        caption: How to read it.
        draw: Draws it as SVG.
    """

    title: str
    caption: str
    draw: Draw


def draw_all(draws: Sequence[Draw], pool: Pool, advance: Advance) -> list[str]:
    """Return the figures as SVG, in their order.

    Args:
        draws: Each draws one, and can be sent to another process.
        pool: Of this machine.
        advance: Called with how many are drawn, and how many there are.

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
            "a process that drew the report died; was it out of memory? All runs are kept: start "
            "again with --workers 1"
        ) from error
    return drawn


def _draw(draw: Draw) -> str:
    return draw()
