"""Tables of many comparisons: a Parquet dataset in folders with Hive partitioning.

DuckDB, pyarrow, Spark and others read it as one table. Appending writes two files and reads no
existing ones.
"""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from urllib.parse import quote

from trajeval_ros.batch import pooling, results_table
from trajeval_ros.batch.finished_comparison import POOLED, RUNS
from trajeval_ros.io.writing import refused_by_disk, write_whole

_SCHEMAS = {RUNS: results_table.SCHEMA, POOLED: pooling.SCHEMA}


def append_to_dataset(folder: Path, title: str, dataset: Path, label: str) -> None:
    """Copy the tables of a comparison into a dataset, in place of those of its title and label.

    `runs.parquet` becomes `runs/schema=1/title=TITLE/label=LABEL/runs.parquet`, and
    `pooled.parquet` likewise. Characters that are not valid in a path are percent-encoded.

    Args:
        folder: Folder of the comparison.
        title: Its title.
        dataset: Folder of the dataset; made if it does not exist.
        label: Name of this comparison among those of its title, such as a commit.

    Raises:
        InputError: It can't be written.
    """
    for name, schema in _SCHEMAS.items():
        _, _, version = schema.partition("/")
        place = dataset.joinpath(
            Path(name).stem,
            f"schema={version}",
            f"title={_coded(title)}",
            f"label={_coded(label)}",
        )
        with refused_by_disk(f"the folder {place}"):
            place.mkdir(parents=True, exist_ok=True)
        write_whole(place / name, partial(shutil.copyfile, folder / name))


def _coded(text: str) -> str:
    return quote(text, safe="")
