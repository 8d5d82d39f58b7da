"""Gates of `trajeval compare`: their options, what they compare with, and the exit status."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli.pipes import may_break
from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.io.writing import write_text

if TYPE_CHECKING:
    from trajeval_ros.batch.gate import Gate
    from trajeval_ros.batch.gate_values import GateValues
    from trajeval_ros.batch.plan import Plan

GATES = "Gates"

BaselineOption = Annotated[
    Path | None,
    typer.Option(
        metavar="OLD.parquet",
        help="The runs.parquet of another comparison, by the same settings.",
        rich_help_panel=GATES,
    ),
]
FailIfOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="GATE",
        help="Exit with status 1 if numbers are worse than in the baseline by more than a "
        "margin, and trials tell it from chance; repeatable. Such as "
        "'ate.position_m.rmse worse than 5 %'.",
        rich_help_panel=GATES,
    ),
]
UndecidedOption = Annotated[
    str,
    typer.Option(
        metavar="pass|fail",
        help="What a gate does that is neither worse nor shown to be no worse.",
        rich_help_panel=GATES,
    ),
]
FalseAlarmsOption = Annotated[
    float,
    typer.Option(
        metavar="PERCENT",
        help="How often gates may call something worse without a change; all gates share it.",
        rich_help_panel=GATES,
    ),
]
PairedOption = Annotated[
    bool,
    typer.Option(
        "--paired",
        help="Trials of one name share a seed with the baseline's, so gates compare them pair by "
        "pair.",
        rich_help_panel=GATES,
    ),
]


@dataclass(frozen=True)
class Gates:
    """What is judged, by what.

    Attributes:
        gates: What may not get worse.
        baseline: The older comparison.
        undecided_fails: Whether the exit status asks for evidence that nothing got worse.
        false_alarms: Chance of an alarm without a change.
        paired: Whether trials of a name share a seed.
    """

    gates: list[Gate]
    baseline: GateValues
    undecided_fails: bool
    false_alarms: float
    paired: bool


def gates_of(
    path: Path | None,
    texts: list[str],
    undecided: str,
    false_alarms: float,
    plan: Plan,
    *,
    paired: bool,
) -> Gates | None:
    """Return gates and what they compare with; refuses what can't be compared before the work."""
    from trajeval_ros.batch.gate import Gate
    from trajeval_ros.batch.gate_values import GateValues, require_same_settings
    from trajeval_ros.batch.results_table import ResultsTable, settings_of

    if (path is None) != (not texts):
        raise SettingsError(
            "--baseline says what to compare with and --fail-if what is worse; give both"
        )
    require_one_of(undecided, ("pass", "fail"), "value of --undecided")
    if not 0.0 < false_alarms <= 20.0:
        raise SettingsError(
            f"--false-alarms {false_alarms:g} is a chance in per cent; give one above 0 and up to "
            "20, such as 2.5"
        )
    if path is None:
        if paired:
            raise SettingsError("--paired is of --baseline and --fail-if; give them, too")
        return None
    gates = [Gate.parse(text) for text in texts]
    for gate in gates:
        if paired and gate.spread_percent is not None:
            raise SettingsError(
                f"--paired measures how much pairs vary, and the gate '{gate}' gives a spread; "
                "leave one of them out"
            )
    values = GateValues(ResultsTable(path))
    require_same_settings(values, settings_of(plan), gates)
    for gate in gates:
        values.find(gate.path)
    return Gates(gates, values, undecided == "fail", false_alarms / 100.0, paired)


def judge(given: Gates, folder: Path, title: str, *, quiet: bool) -> None:
    """Write and print the verdicts; exit with status 1 if something is worse."""
    from trajeval_ros.batch import gates
    from trajeval_ros.batch.comparison import GATES as GATES_FILE
    from trajeval_ros.batch.comparison import GATES_JSON, RUNS
    from trajeval_ros.batch.gate_values import GateValues, remarks_on
    from trajeval_ros.batch.gates_json import to_json
    from trajeval_ros.batch.gates_markdown import to_markdown
    from trajeval_ros.batch.results_table import ResultsTable

    now = GateValues(ResultsTable(folder / RUNS))
    judgement = gates.judge(
        given.gates, given.baseline, now, given.false_alarms, paired=given.paired
    )
    remarks = remarks_on(given.baseline, now)
    text = to_markdown(judgement, title, remarks)
    write_text(folder / GATES_FILE, text)
    write_text(folder / GATES_JSON, to_json(judgement, title, remarks))
    if not quiet:
        with may_break():
            print(f"\n{text}", end="")
    if judgement.fails or (given.undecided_fails and not judgement.is_no_worse):
        raise typer.Exit(1)
