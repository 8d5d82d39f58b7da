"""`trajeval diagnose`: tests of a pair of trajectories for common mistakes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import argument, settings_options, shared_options, sources_of
from trajeval_ros.cli.programs import write_json
from trajeval_ros.cli.progress import read_shown, report_dropped
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.setting import AUTO, DIAGNOSE
from trajeval_ros.io.results.result_json import findings_json
from trajeval_ros.io.source_names import names_of
from trajeval_ros.pipeline.diagnosing import diagnose as search

_TWO = 2  # groundtruth and estimate

_PARAMETERS = (
    argument("by_position", metavar="GROUNDTRUTH ESTIMATE", count=-1, is_required=False,
        help="Sources, as for `trajeval evaluate`, instead of -g and -e."),
    *settings_options(DIAGNOSE),
    *shared_options(DIAGNOSE),
)  # fmt: skip


@verb(*_PARAMETERS)
def diagnose(
    by_position: Sequence[str],
    groundtruth: str | None,
    estimate: Sequence[str],
    json: str | None,
    **settings: Any,
) -> None:
    """Searches for mistakes that explain a bad or suspicious result.

    Prints every test with its statistics and its result, or the reason why it is not applicable
    (docs/diagnosis.md). Findings do not change any result. To correct a mistake, use --correct
    of trajeval evaluate.

        trajeval diagnose groundtruth.txt estimate.txt --modality stereo-inertial
    """
    if settings["time_offset"] == AUTO:
        raise SettingsError(
            "--time-offset auto: diagnose estimates the clock offset anyway; remove it, or give "
            "seconds"
        )
    request = request_from(settings)
    sources = sources_of("diagnose", by_position, groundtruth, estimate)
    if len(sources) != _TWO:
        raise SettingsError(f"diagnose tests one estimate, not {len(sources) - 1}; give one")
    first, second = read_shown(sources, names_of(sources), covariances=[False, True])
    request = request.for_trajectories(first, [second])
    found, refused = search(first, second, request)
    write_json(json, {"findings": findings_json(found.findings), "examined": _scores(found)})
    if json != "-":
        _print(found, refused)
    report_dropped([first, second])


def _scores(found: Diagnosis) -> list[dict[str, Any]]:
    return [
        {
            "test": each.test,
            "scores": {
                name: value if math.isfinite(value) else None
                for name, value in each.scores.items()
            },
            "seen": [seen.cause for seen in each.seen],
            "why_not": each.why_not or None,
        }
        for each in found.examined
    ]


def _print(found: Diagnosis, refused: str) -> None:
    from trajeval_ros.report.console import console
    from trajeval_ros.report.verdict_lines import explanation

    terminal = console()
    if refused:
        terminal.print(f"evaluation not possible: {refused}", soft_wrap=True)
    for finding in found.findings:
        terminal.print(f"{finding.cause}: {finding.text}", soft_wrap=True)
    if not found.findings:
        terminal.print(
            "no mistake found; docs/diagnosis.md lists mistakes that recordings cannot reveal",
            soft_wrap=True,
        )
    terminal.print("\ntests, their results and statistics:")
    for line in explanation(found):
        terminal.print(f"  {line}", soft_wrap=True)
