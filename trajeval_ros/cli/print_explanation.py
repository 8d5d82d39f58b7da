"""`trajeval explain`: which definitions give a published number."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import argument, option, shared_options
from trajeval_ros.cli.programs import write_json
from trajeval_ros.cli.progress import progress, report_dropped
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.explanation.definition import Command, Definition, command_of
from trajeval_ros.explanation.explain import UNITS, Explanation, Match, PublishedNumber
from trajeval_ros.explanation.explain import explain as search
from trajeval_ros.formatting.numbers import counted, significant
from trajeval_ros.io.checks import require_known
from trajeval_ros.io.sources import read_many
from trajeval_ros.io.yaml_file import read_mapping

SCHEMA = "trajeval-explanation/1"
_NOT_NAMED = 3  # exit status
_SHOWN = 4
_VERDICTS = {
    "named": "named: this definition gives the digits; this does not prove that it was used",
    "possible": "possible: give more digits, or the numbers of other sequences (--run)",
    "chance": "chance: an unrelated number of this size has matches as likely; give more digits, "
    "or the numbers of other sequences (--run)",
    "none": "none: no definition gives this; check the run, the files, the time span and the "
    "groundtruth. The nearest likely values:",
}
Axes = tuple[str, str]  # vertical ones of groundtruth and estimate
Run = tuple[str, str, list[str]]  # groundtruth, estimate and numbers


@verb(
    argument("given", metavar="GROUNDTRUTH ESTIMATE NUMBER", count=-1, is_required=False,
        help="Sources, as for `trajeval evaluate`, and the published number with all of its "
        "digits, as in 0.20. Or a single YAML file with `unit` and `runs`."),
    option("--unit", metavar="NAME",
        help=f"Unit of the numbers: {', '.join(UNITS)}. Default: the numbers are compared in m, "
        "%, deg and deg/m."),
    option("--with", "with_number", metavar="NUMBER",
        help="Other number of the same row of a table, as in 1.25deg. It has the same alignment "
        "and association, and its own statistic."),
    option("--run", metavar="GROUNDTRUTH ESTIMATE NUMBER", count=3, is_repeatable=True,
        help="Run with a number of the same column of a table. Repeatable."),
    *shared_options("explain"),
)  # fmt: skip
def explain(
    given: Sequence[str],
    unit: str | None,
    with_number: str | None,
    run: Sequence[tuple[str, str, str]],
    json: str | None,
) -> int:
    r"""Finds the definition that gives a published number.

    Compares the number with the values of evo, rpg_trajectory_evaluation, KITTI's devkit and
    their variants, and prints the command of every match (docs/explain.md). The exit status is 0
    if one definition is named, otherwise 3.

        trajeval explain groundtruth.txt estimate.txt 0.061 --unit m

    Two numbers of one row of a table:

        trajeval explain groundtruth.txt estimate.txt 0.061m --with 1.25deg

    Numbers of one column, for several sequences; from four on, one of them may be wrong:

        trajeval explain --unit m --run gt1.txt vio1.txt 0.21 \
            --run gt2.txt vio2.txt 0.63
    """
    runs, unit = _runs(given, run, with_number, unit)
    sources = [source for truth, estimate, _ in runs for source in (truth, estimate)]
    with progress("reading") as advance:
        trajectories = read_many(sources, advance=advance)
    sides = zip(trajectories[::2], trajectories[1::2], runs, strict=True)
    explanation = search([(truth, estimate, run[2]) for truth, estimate, run in sides], unit or "")
    up = trajectories[0].up.name, trajectories[1].up.name
    write_json(json, _json(explanation, up))
    if json != "-":
        _print(explanation, runs, up, unit or "")
    report_dropped(trajectories)
    return 0 if explanation.verdict == "named" else _NOT_NAMED


def _runs(
    given: Sequence[str],
    runs: Sequence[tuple[str, str, str]],
    with_number: str | None,
    unit: str | None,
) -> tuple[list[Run], str | None]:
    """Return the runs of the command line or of a YAML file, and the unit."""
    if len(given) == 3 and not runs:
        return [(given[0], given[1], [given[2], *([with_number] if with_number else [])])], unit
    is_file = len(given) == 1 and Path(given[0]).suffix in (".yaml", ".yml")
    if with_number or is_file == bool(runs) or len(given) != is_file:
        raise SettingsError(
            "the number needs its run; give GROUNDTRUTH ESTIMATE NUMBER (and --with), --run for "
            "every run, or a single YAML file"
        )
    if runs:
        return [(truth, estimate, [number]) for truth, estimate, number in runs], unit
    path = Path(given[0])
    content = read_mapping(path, "list of runs", as_text=True)
    require_known(content, ("unit", "runs"), str(path))
    listed: list[Run] = []
    for item in content.get("runs") or ():
        keys = ("groundtruth", "estimate", "number")
        if not isinstance(item, dict) or item.keys() != set(keys):
            raise InputError(
                f"{path}: every run needs exactly {', '.join(keys)}; correct {item!r}"
            )
        truth, estimate, numbers = (item[key] for key in keys)
        numbers = numbers if isinstance(numbers, list) else [numbers]
        listed.append((str(path.parent / truth), str(path.parent / estimate), numbers))
    return listed, unit or content.get("unit")


def _print(explanation: Explanation, runs: Sequence[Run], up: Axes, unit: str) -> None:
    from trajeval_ros.report.console import console

    terminal = console()

    def line(text: str) -> None:
        terminal.print(text, soft_wrap=True)

    line(
        f"{counted(explanation.searched, 'definition')}, {explanation.matching} match; an "
        f"unrelated number has {explanation.expected:.2g} matches on average, and at least one in "
        f"{100.0 * explanation.any_probability:.0f} % of cases"
    )
    if not all(PublishedNumber.parse(text, unit).unit for *_, texts in runs for text in texts):
        line("note: numbers without a unit are compared in m, %, deg and deg/m; set --unit")
    line(_VERDICTS[explanation.verdict])
    if explanation.disagreeing is not None:
        truth, estimate, texts = runs[explanation.disagreeing]
        line(
            f"run {explanation.disagreeing + 1} does not fit: {truth} {estimate} "
            f"{' '.join(texts)}; all other {len(runs) - 1} runs do"
        )
    for match in (explanation.matches or explanation.nearest)[:_SHOWN]:
        most = 0.99 if len(runs) == 1 and len(match.definitions) == 1 else 1.0
        share = f"{100.0 * min(match.probability, most):5.1f} %  " if explanation.matches else ""
        for definition, values in zip(match.definitions, match.values, strict=True):
            shown = " ".join(significant(value, 6) for value in values)
            line(f"{share}{shown} {definition.unit}  {definition}")
        line(f"         association {', '.join(match.associations)}")
        if match.others:
            line(f"         equal: {'; '.join(match.others)}")
        for text in _commands(match, *runs[0][:2], up) if explanation.matches else ():
            line(f"         {text}")
    if explanation.matches:
        line(f"{100.0 * explanation.none_probability:5.1f} %  none of these")


def _commands(match: Match, truth: str, estimate: str, up: Axes) -> Iterator[str]:
    for definition in match.definitions:
        command = command_of(definition, up)
        if isinstance(command, str):
            yield command
            continue
        sides = (estimate, truth) if command.exchanged else (truth, estimate)
        words = shlex.join(["trajeval", "evaluate", *sides, *command.options])
        yield f"{words}   # {command.formula}"
        if command.file:
            yield "protocol.yaml: {" + ", ".join(command.file.splitlines()) + "}"


def _json(explanation: Explanation, up: Axes) -> dict[str, Any]:
    def number(definition: Definition, values: tuple[float, ...]) -> dict[str, Any]:
        command = command_of(definition, up)
        return {
            "definition": definition._asdict(),
            "text": str(definition),
            "unit": definition.unit,
            "values": list(values),
            "command": command._asdict() if isinstance(command, Command) else None,
            "no_command": command if isinstance(command, str) else "",
        }

    def match(item: Match) -> dict[str, Any]:
        return {
            "probability": item.probability if explanation.matches else None,
            "associations": list(item.associations),
            "equal": list(item.others),
            "numbers": [*map(number, item.definitions, item.values)],
        }

    lists = {key: [*map(match, getattr(explanation, key))] for key in ("matches", "nearest")}
    return {"schema": SCHEMA, "verdict": explanation.verdict, **vars(explanation), **lists}
