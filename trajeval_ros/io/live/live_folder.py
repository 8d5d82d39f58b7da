"""Evaluation of the output folder of a live run, with the pipeline for recorded runs.

`NAME.pairs` has the pairs of an estimate, `NAME.2.pairs` those of its second segment, after a
restart or a step back in time. A segment is evaluated as a run of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.io.live.pair_file import SUFFIX
from trajeval_ros.io.live.pair_file_evaluation import EvaluatedPairFile, evaluate_pair_file
from trajeval_ros.pipeline.outcome import FailedRun, Outcome, RunOutcome
from trajeval_ros.pipeline.request import Request
from trajeval_ros.pipeline.several_runs import with_own_errors


def evaluate_folder(
    folder: Path, request: Request | None = None, align_with: str | None = None
) -> Outcome:
    """Evaluate all estimates of a live run, which can still be running.

    Args:
        folder: The live evaluator's output folder.
        request: Calibration and tests; its protocol is replaced by that of the live run.
        align_with: See `Protocol`; None for the live run's setting.

    Raises:
        InputError: There is no pair file, or none can be evaluated.
        SettingsError: The request needs data that pairs do not have.
    """
    # The gauge is the live run's, also if that was its default.
    request = dataclasses.replace(request or Request(), gauge_is_default=False)
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(
            f"no live run in {folder} (no file *{SUFFIX}); give the output folder of the evaluator"
        )
    evaluated: list[EvaluatedPairFile] = []
    failed: list[FailedRun] = []
    for path in paths:
        try:
            estimate = evaluate_pair_file(path, request, align_with)
        except SettingsError:
            raise
        except TrajevalError as error:
            name = path.name.removesuffix(SUFFIX)
            failed.append(FailedRun(name, str(path), str(error)))
            continue
        evaluated.append(estimate)
    if not evaluated:
        raise InputError("; ".join(failure.reason for failure in failed))
    evaluated.sort(key=lambda estimate: (estimate.place, estimate.segment))
    runs = tuple(_with_own_errors(evaluated))
    return Outcome(request, evaluated[0].groundtruth, runs, tuple(failed))


def _with_own_errors(evaluated: Sequence[EvaluatedPairFile]) -> Iterator[RunOutcome]:
    """Yield the runs, with own errors if the groundtruth is GNSS fixes.

    Jumps are attributed to fixes or estimates by comparing the estimates of one segment.
    """
    completed: dict[int, RunOutcome] = {}
    for segment in {estimate.segment for estimate in evaluated}:
        rows = [row for row, estimate in enumerate(evaluated) if estimate.segment == segment]
        runs = with_own_errors([evaluated[row].run for row in rows], evaluated[rows[0]].fixes)
        completed.update(zip(rows, runs, strict=True))
    for row in range(len(evaluated)):
        yield completed[row]
