"""Writing of the result files of an evaluation: result.json, errors.npz, errors.parquet."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.results.error_archive import TABLE, error_files
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.writing import refused_by_disk, write_text, write_whole
from trajeval_ros.pipeline.outcome import Outcome


def write_result(outcome: Outcome, folder: str | Path) -> Path:
    """Write result.json, errors.npz and, with pyarrow, errors.parquet (docs/result.md).

    Every file is written completely or not at all.

    Args:
        outcome: Result of `run`.
        folder: Output folder, created if it does not exist. Files of the same names are replaced.

    Returns:
        The path of result.json. The same outcome gives the same bytes.

    Raises:
        InputError: A file can't be written.

    Example:
        >>> import json, tempfile
        >>> from trajeval_ros import run, simulate, write_result
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = write_result(run(flight.groundtruth, [flight.estimate]), folder)
        ...     result = json.loads(path.read_text())
        >>> path.name, len(result["runs"])
        ('result.json', 1)
    """
    folder = Path(folder)
    with refused_by_disk(f"the folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / TABLE).unlink(missing_ok=True)  # can be from another run, written with pyarrow
    for name, write in error_files(outcome).items():
        write_whole(folder / name, write)
    write_text(folder / "result.json", json_text(result_of(outcome), indent=2))
    return folder / "result.json"
