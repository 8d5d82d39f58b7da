"""A comparison of finished results: output folders of `trajeval evaluate` and of live runs.

Nothing is evaluated again: numbers are those of result.json, and errors and paths those of
errors.npz. The inputs need not exist any more.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajeval_ros.batch.comparison import Progress
from trajeval_ros.batch.fingerprints import hash_of_file
from trajeval_ros.batch.finished_comparison import (
    RESULT,
    FinishedComparison,
    FinishedRun,
    pooled_rows,
    rows_of_run,
)
from trajeval_ros.batch.plan import PlannedRun, association_of, natural
from trajeval_ros.batch.records import RECORDS, Record, RecordStore, encode
from trajeval_ros.batch.results_table import require_types
from trajeval_ros.batch.worker import columns_to_draw
from trajeval_ros.exceptions import InputError, TrajevalError, reason_of
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.json_file import mapping_in_file, require_schema
from trajeval_ros.io.npz_file import read_arrays
from trajeval_ros.io.results.error_archive import ARCHIVE
from trajeval_ros.io.results.result_json import SCHEMA
from trajeval_ros.io.source_names import names_of, split_name

# Errors do not depend on these settings. A modality only names a gauge.
_NOT_OF_ERRORS = frozenset(
    {"modality", "covariance", "rotation_covariance_frame", "nees_form", "alert_limit", "risk",
     "watch_factor"}
)  # fmt: skip
_ERRORS = ("stamps", "position_m", "rotation_deg", "position_world_m", "aligned_positions")


@dataclass(frozen=True, eq=False)
class _Result:
    """One run of a result folder."""

    folder: Path
    content: dict[str, Any]  # of result.json, with this run alone
    algorithm: str  # name that the user gave; "" for that of the estimate

    @property
    def name(self) -> str:
        """Name of the estimate."""
        return str(self.content["runs"][0]["estimate"]["name"])

    @property
    def settings(self) -> dict[str, Any]:
        """Settings by name, also in Parquet tables."""
        return {**self.content["provenance"]["settings"], "common_time_span": False}

    @property
    def groundtruth(self) -> tuple[str, str]:
        """Source and hash of the groundtruth."""
        source = self.content["groundtruth"]["source"]
        return str(source), str(self.content["provenance"]["inputs"][source])


def is_result(target: str) -> bool:
    """Return whether FOLDER or NAME=FOLDER has finished results."""
    return (Path(split_name(target)[1]) / RESULT).is_file()


class FinishedResults:
    """Results that are shown together.

    The algorithm is the given name or that of the estimate, and the sequence is the groundtruth's
    name. A given name precedes those of several estimates in a folder. If different
    groundtruths have one name, as a topic in several live runs, the folder's name is the sequence.
    If a sequence has several results of one name, the folder's name is added to the algorithm.
    """

    def __init__(self, folders: Sequence[str]) -> None:
        """Read result.json of all folders, FOLDER or NAME=FOLDER.

        Raises:
            InputError: A folder can't be read, or the results have different settings.
        """
        named = [split_name(item) for item in folders]
        self._results = [item for name, folder in named for item in _read(name, Path(folder))]
        _require_same_settings(self._results)
        self._names = _names(self._results)
        self.settings = self._results[0].settings

    @property
    def advice(self) -> str:
        """How to name the results if each has another algorithm and sequence; else ""."""
        count = len(self._names)
        if count == 1 or any(len(set(item)) < count for item in zip(*self._names, strict=True)):
            return ""
        return (
            "every estimate has another name and another sequence; give results of one algorithm "
            "one name: trajeval compare NAME=RESULT NAME=RESULT, or -e NAME=ESTIMATE in evaluate"
        )

    def write_tables(self, output: Path) -> Progress:
        """Write the records and the Parquet tables of the comparison."""
        records = RecordStore(output / RECORDS)
        finished, entries = {}, []
        for result, name in zip(self._results, self._names, strict=True):
            key = _key(result, name)
            with _damage_refused(f"{result.folder / RESULT} or its {ARCHIVE}"):
                estimate = result.content["runs"][0]["estimate"]["source"]
                run = PlannedRun(*name, "", groundtruth=result.groundtruth[0], estimate=estimate)
                finished[name] = FinishedRun(run, key, key)
                if key not in records:
                    record = _record(result, key)
                    require_types(rows_of_run(finished[name], record))
                    list(pooled_rows(*name, 1, [record]))
                    entries.append(encode(record))
        for entry in entries:  # after all results were checked
            records.add(entry)
        title = output.resolve().name
        comparison = FinishedComparison(title, self.settings, list(_in_order(finished)))

        def record_of(run: FinishedRun) -> Record:
            record = records.read(run.key)
            if record is None:
                raise InputError(f"{output / RECORDS} is damaged; remove it and start again")
            return record

        comparison.write_tables(output, record_of)
        return Progress(total=len(self._results), kept=len(self._results))


@contextmanager
def _damage_refused(what: str) -> Iterator[None]:
    """Refuse a result that was changed: its values can have any type."""
    try:
        yield
    except (TrajevalError, OSError):
        raise
    except Exception as error:
        raise InputError(f"{what} is damaged; evaluate the run again") from error


def _read(given: str, folder: Path) -> Iterator[_Result]:
    path = folder / RESULT
    try:
        content = mapping_in_file(path)
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    advice, schema = "evaluate the run again", (content or {}).get("schema")
    require_schema(path, schema, SCHEMA, "result of an evaluation", advice)
    assert content is not None
    if not (folder / ARCHIVE).is_file():
        raise InputError(f"{folder} has no {ARCHIVE}, which a comparison needs; {advice}")
    with _damage_refused(str(path)):
        results = []
        for run in content["runs"]:
            name = f"{given} {run['estimate']['name']}" if len(content["runs"]) > 1 else given
            result = _Result(folder, {**content, "runs": [run], "failed": []}, given and name)
            hash((result.name, *result.groundtruth, *map(str, result.settings)))
            results.append(result)
    yield from results


def _require_same_settings(results: Sequence[_Result]) -> None:
    first = results[0]
    for result in results[1:]:
        for name, value in result.settings.items():
            before = first.settings.get(name)
            if before != value and name not in _NOT_OF_ERRORS:
                raise InputError(
                    f"{first.folder} was evaluated with {name} {before}, and {result.folder} with "
                    f"{name} {value}; evaluate both with the same settings"
                )


def _names(results: Sequence[_Result]) -> list[tuple[str, str]]:
    """Return algorithm and sequence of every result, without repetitions."""
    folders = names_of([str(item.folder.resolve()) for item in results])
    folder_of = [name.partition("#")[0] for name in folders]
    sources = [item.groundtruth for item in results]
    plain = [names_of([source])[0] for source, _ in sources]
    hashes = Counter(
        name for name, _ in set(zip(plain, (item for _, item in sources), strict=True))
    )
    sequences = [
        folder if hashes[name] > 1 else name for name, folder in zip(plain, folder_of, strict=True)
    ]
    # Files of one name per sequence, as in vio/MH_01.txt, are named by their folder.
    algorithms = [
        result.algorithm or result.name.removesuffix(f"/{name}")
        for result, name in zip(results, plain, strict=True)
    ]
    counts = Counter(zip(algorithms, sequences, strict=True))
    names = [
        (f"{folder} {algorithm}" if counts[algorithm, sequence] > 1 else algorithm, sequence)
        for algorithm, sequence, folder in zip(algorithms, sequences, folder_of, strict=True)
    ]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(f"{twice[0][0]} on {twice[0][1]} is given twice; give every folder once")
    return names


def _in_order(finished: dict[tuple[str, str], FinishedRun]) -> Iterator[FinishedRun]:
    """Yield all runs by algorithm and sequence, including missing ones."""
    sequences = natural({sequence for _, sequence in finished})
    for algorithm in dict.fromkeys(algorithm for algorithm, _ in finished):
        for sequence in sequences:
            why = f"no folder has a result of {algorithm} on {sequence}"
            missing = PlannedRun(algorithm, sequence, "", missing=why)
            yield finished.get((algorithm, sequence), FinishedRun(missing, "", "", why))


def _key(result: _Result, name: tuple[str, str]) -> str:
    digest = hashlib.sha256("\n".join((*name, result.name)).encode())
    for file in (RESULT, ARCHIVE):
        digest.update(bytes.fromhex(hash_of_file(result.folder / file)))
    return digest.hexdigest()[:32]


def _record(result: _Result, key: str) -> Record:
    run, path = result.content["runs"][0], result.folder / ARCHIVE
    lengths = () if run["re"] is None else tuple(result.settings["lengths"])
    of_length = [
        f"{length}.{name}" for length in lengths for name in ("position_m", "rotation_deg")
    ]
    prefix = f"{result.name}."
    arrays = {
        name.removeprefix(prefix): array
        for name, array in read_arrays(
            path, [prefix + error for error in (*_ERRORS, *of_length)]
        ).items()
    }
    if any(array.dtype.kind not in "fiu" for array in arrays.values()):
        raise InputError(f"{path} has no numbers; evaluate the run again")
    up = UpAxis(**result.content["groundtruth"]["up"])
    aligned, stamps = arrays["aligned_positions"], arrays["stamps"]
    # The error is groundtruth minus aligned estimate.
    groundtruth = aligned + arrays["position_world_m"]
    drawn = columns_to_draw(
        stamps,
        arrays["position_m"],
        arrays.get("rotation_deg"),
        up.to_z_up(aligned),
        (stamps, up.to_z_up(groundtruth)),
        association_of(result.settings),
    )
    pooled = {name: arrays[name] for name in of_length if name in arrays}
    span_ns = (int(stamps[0]), int(stamps[-1]))
    return Record(key, result.content, lengths, span_ns, {**pooled, **drawn})
