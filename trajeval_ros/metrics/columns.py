"""Columns of numbers as other libraries' tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError

if TYPE_CHECKING:
    import pandas
    import pyarrow

Columns = Mapping[str, NDArray[Any]]


def arrow_table(columns: Columns) -> pyarrow.Table:
    """Return columns of equal lengths as an Arrow table.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow
    except ImportError as error:
        raise InputError(
            "an Arrow table needs pyarrow, which is not installed: pip install pyarrow"
        ) from error
    return pyarrow.table({name: np.ascontiguousarray(each) for name, each in columns.items()})


def pandas_frame(columns: Columns) -> pandas.DataFrame:
    """Return columns of equal lengths as a pandas data frame.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError(
            "a data frame needs pandas, which is not installed: pip install pandas"
        ) from error
    return pandas.DataFrame(dict(columns))
