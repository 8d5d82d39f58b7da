"""Sources of `trajeval evaluate RECORDING`: the likely evaluation, stated, or a refusal."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.cli.command import arguments
from trajeval_ros.cli.progress import progress
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, note
from trajeval_ros.geometry.source_info import ASSUMED
from trajeval_ros.io.sources import BAG_ENDINGS, parse_source

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.io.roles import LikelyEvaluation


def recording_of(by_position: Sequence[str], *named: object) -> str:
    """Return the only source of a command if it is a bag, a log or a folder; "" otherwise.

    A missing or damaged file with the ending of a bag or log is one, so its reader states why.
    """
    if len(by_position) != 1 or any(named):
        return ""
    path = Path(by_position[0])
    if path.is_dir() or path.suffix in (".ulg", *BAG_ENDINGS):
        return by_position[0]
    is_bag = path.is_file() and parse_source(by_position[0]).is_bag
    return by_position[0] if is_bag else ""


def chosen_evaluation(
    recording: str, read: dict[str, Trajectory], *, is_gauge_given: bool
) -> LikelyEvaluation:
    """Return the likely evaluation of a recording; `read` receives its trajectories by SOURCE.

    Raises:
        InputError: No groundtruth or no estimate is likely, or two evaluations are equally likely.
    """
    import shlex

    from trajeval_ros.io.roles import describe_all, likely_evaluations
    from trajeval_ros.report.console import console

    with progress(f"searching {recording}") as advance:
        description = describe_all(Path(recording), read, advance)
    likely = likely_evaluations(description, has_one_gauge=is_gauge_given)
    if len(likely) == 1 and likely[0].groundtruth:
        return likely[0]
    if not likely:
        look = f"trajeval info {shlex.quote(recording)}"
        damage = [f"; {item.text}" for item in description.remarks if item.level is Level.ERROR]
        raise InputError(
            f"{recording} has no two likely sides; list its topics: {look}{''.join(damage)}"
        )
    commands = [evaluation.command() for evaluation in likely]
    if not likely[0].groundtruth:
        raise InputError(f"{recording} has no likely groundtruth; name it: {commands[0]}")
    for command in commands:
        console().print(command, soft_wrap=True)
    raise InputError(
        f"{recording} has {counted(len(likely), 'likely evaluation')}, so none is calculated; "
        "call one of these commands"
    )


def as_read(
    read: Mapping[str, Trajectory], sources: Sequence[str], names: Sequence[str]
) -> list[Trajectory]:
    """Return trajectories of the search as reading them again without covariances does."""
    return [
        dataclasses.replace(
            read[source],
            name=name,
            reading=dataclasses.replace(read[source].reading, source=source),
        )
        for source, name in zip(sources, names, strict=True)
    ]


def with_reasons(groundtruth: Trajectory, chosen: LikelyEvaluation) -> Trajectory:
    """Return the groundtruth with a note for every choice."""
    notes = tuple(note(ASSUMED, reason) for reason in chosen.reasons)
    reading = groundtruth.reading
    reading = dataclasses.replace(reading, remarks=(*reading.remarks, *notes))
    return dataclasses.replace(groundtruth, reading=reading)


def repeated(chosen: LikelyEvaluation, recording: str) -> str:
    """Return the command with sources and sensors in place of the recording."""
    import shlex

    given = [word for word in arguments() if word != recording]
    command = dataclasses.replace(chosen, options="").command()
    return " ".join([command, *map(shlex.quote, given)])
