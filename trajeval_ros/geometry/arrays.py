"""Type aliases of arrays. Docstrings give shapes and units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]  # nanoseconds
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]
