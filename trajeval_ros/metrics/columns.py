"""Conversion of columns to tables of other libraries: Arrow, Parquet, pandas."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import install_command, pyarrow_command

if TYPE_CHECKING:
    import pandas
    import pyarrow

Columns = Mapping[str, NDArray[Any]]
ArrayColumns = dict[str, NDArray[Any]]

_XYZ, _TURNS = ("x", "y", "z"), ("roll", "pitch", "yaw")
_COMPONENTS = {3: _XYZ, 4: (*_XYZ, "w"), 6: (*_XYZ, *_TURNS)}


def columns_of(errors: Any) -> ArrayColumns:
    """Return the fields of a dataclass of arrays that are not None, by name."""
    return {
        field.name: column
        for field in dataclasses.fields(errors)
        if (column := getattr(errors, field.name)) is not None
    }


def component_columns(columns: Columns) -> ArrayColumns:
    """Return columns of shape (N,): a column of vectors is split into its components.

    `aligned_positions` (N, 3) becomes `aligned_positions_x`, `_y` and `_z`. Components of
    rotations are `_roll`, `_pitch` and `_yaw`. Points in names become underscores.
    """
    components = {}
    for name, column in columns.items():
        plain = name.replace(".", "_")
        if column.ndim == 1:
            components[plain] = column
            continue
        width = column.shape[1]
        names = _TURNS if width == 3 and name.startswith("rotation") else _COMPONENTS[width]
        components |= {f"{plain}_{item}": column[:, at] for at, item in enumerate(names)}
    return components


def arrow_table(columns: Columns) -> pyarrow.Table:
    """Return columns of equal lengths as an Arrow table."""
    pyarrow = _load_pyarrow()
    return pyarrow.table({name: arrow_array(pyarrow, array) for name, array in columns.items()})


def arrow_array(pyarrow: Any, column: NDArray[Any]) -> Any:
    """Return a column, (N,), as an Arrow array.

    `pyarrow.array` imports pandas if it is installed, which takes longer than a table.
    """
    values = np.ascontiguousarray(column)
    if values.dtype.kind in "iuf":
        buffers = [None, pyarrow.py_buffer(values)]
        kind = pyarrow.from_numpy_dtype(values.dtype)
        return pyarrow.Array.from_buffers(kind, len(values), buffers)
    if values.dtype.kind == "U":
        words = [word.encode() for word in values.tolist()]
        offsets = np.cumsum([0, *map(len, words)], dtype=np.int32)
        text = pyarrow.py_buffer(offsets), pyarrow.py_buffer(b"".join(words))
        return pyarrow.StringArray.from_buffers(len(values), *text)
    return pyarrow.array(values)


def write_parquet(
    path: Path, label: str, tables: Sequence[tuple[str, Columns]], metadata: Mapping[str, str]
) -> None:
    """Write tables with their names, one after the other, to a Parquet file.

    The first column, `label`, has the name of the table. Columns that a table lacks are null.
    """
    pyarrow = _load_pyarrow()
    from pyarrow import parquet

    named = []
    for name, columns in tables:
        table = arrow_table(columns)
        named.append(table.add_column(0, label, pyarrow.repeat(name, len(table))))
    table = pyarrow.concat_tables(named, promote_options="default")
    # A dictionary of measured numbers has as many entries as rows, and is given up late.
    parquet.write_table(table.replace_schema_metadata(metadata), path, use_dictionary=[label])


def have_pyarrow() -> bool:
    """Return whether pyarrow is installed and can be imported."""
    try:
        _load_pyarrow()
    except InputError:
        return False
    return True


def _load_pyarrow() -> Any:
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise InputError(
            f"an Arrow table needs pyarrow; install it: {pyarrow_command()}"
        ) from error
    except ImportError as error:
        raise InputError(
            f"pyarrow is installed but can't be imported ({error}); install a version that "
            f"works: {pyarrow_command()}"
        ) from error
    return pyarrow


def pandas_frame(columns: Columns) -> pandas.DataFrame:
    """Return columns of equal lengths as a pandas data frame."""
    try:
        import pandas
    except ImportError as error:
        raise InputError(
            f"a data frame needs pandas; install it: {install_command('pandas')}"
        ) from error
    return pandas.DataFrame(dict(columns))
