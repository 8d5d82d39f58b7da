"""Gates of `trajeval compare`: options, baseline and exit status."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trajeval_ros.cli.pipes import may_break
from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.io.writing import write_text

if TYPE_CHECKING:
    from trajeval_ros.batch.gate import Gate
    from trajeval_ros.batch.gate_values import GateValues

GATES = "Gates"
UNDECIDED, FALSE_ALARMS = "pass", 2.5  # defaults

BaselineOption = Annotated[
    Path | None,
    typer.Option(
        metavar="OLD.parquet",
        help="File runs.parquet of another comparison with the same settings.",
        rich_help_panel=GATES,
    ),
]
FailIfOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="GATE",
        help="Gate, such as 'ate.position_m.rmse worse than 5 %'. The exit status is 1 if a value "
        "is worse than in the baseline by more than the margin, with statistical significance. "
        "Repeatable.",
        rich_help_panel=GATES,
    ),
]
UndecidedOption = Annotated[
    str,
    typer.Option(
        metavar="pass|fail",
        help="Verdict of a gate whose test is inconclusive: pass or fail.",
        rich_help_panel=GATES,
    ),
]
FalseAlarmsOption = Annotated[
    float,
    typer.Option(
        metavar="PERCENT",
        help="Probability of a false alarm over all gates, in percent.",
        rich_help_panel=GATES,
    ),
]
PairedOption = Annotated[
    bool,
    typer.Option(
        "--paired",
        help="Paired test, for trials that share seeds with the trials of the same name in the "
        "baseline.",
        rich_help_panel=GATES,
    ),
]


@dataclass(frozen=True)
class Gates:
    """Gates and their baseline.

    Attributes:
        gates: The gates.
        baseline: Values of the older comparison.
        undecided_fails: Whether an inconclusive verdict causes exit status 1.
        false_alarms: Probability of a false alarm.
        paired: Whether trials of the same name have the same seed.
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
    settings: dict[str, Any],
    *,
    paired: bool,
) -> Gates | None:
    """Return the gates and their baseline; None without gates.

    Args:
        path: Table of the baseline.
        texts: Gates in the notation of the command line.
        undecided: `pass` or `fail`: the result of an inconclusive verdict.
        false_alarms: Probability of a false alarm, percent.
        settings: Settings of this comparison.
        paired: Whether trials of the same name have the same seed.

    Raises:
        InputError: The baseline can't be read, or its settings differ.
        SettingsError: An option is not valid or is missing.
    """
    from trajeval_ros.batch.gate import Gate
    from trajeval_ros.batch.gate_values import GateValues, require_same_settings
    from trajeval_ros.batch.results_table import ResultsTable

    if (path is None) != (not texts):
        raise SettingsError("--baseline and --fail-if belong together; give both")
    require_one_of(undecided, ("pass", "fail"), "value of --undecided")
    if not 0.0 < false_alarms <= 20.0:
        raise SettingsError(
            f"--false-alarms {false_alarms:g} is out of range; give a percentage above 0 and up "
            "to 20, such as 2.5"
        )
    if path is None:
        if paired or undecided != UNDECIDED or false_alarms != FALSE_ALARMS:
            raise SettingsError(
                "--paired, --undecided and --false-alarms need --baseline and --fail-if; give both"
            )
        return None
    gates = [Gate.parse(text) for text in texts]
    for gate in gates:
        if paired and gate.spread_percent is not None:
            raise SettingsError(
                f"--paired estimates the spread, and gate '{gate}' also gives one; remove one of "
                "them"
            )
    values = GateValues(ResultsTable(path))
    require_same_settings(values, settings, gates)
    for gate in gates:
        values.find(gate.path)
    return Gates(gates, values, undecided == "fail", false_alarms / 100.0, paired)


def judge(given: Gates, folder: Path, title: str, *, quiet: bool) -> None:
    """Write and print the verdicts; exit with status 1 if the gates fail."""
    from trajeval_ros.batch import gates
    from trajeval_ros.batch.finished_comparison import GATES as GATES_FILE
    from trajeval_ros.batch.finished_comparison import GATES_JSON, RUNS
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
