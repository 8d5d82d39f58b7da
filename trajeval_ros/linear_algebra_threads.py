"""How many threads numpy's and scipy's linear algebra takes.

Our matrices are small: a second thread mostly waits in a loop for work, which takes a third of
the CPU time of a small evaluation, and half of a continuous association's. So programs take one
thread, unless the environment says how many. Libraries read it when they are imported. As a
library, the package changes nothing.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


def take_one_thread() -> None:
    """Have this process and those that it starts use one, unless the environment says more."""
    for name in _unset():
        os.environ[name] = "1"


@contextmanager
def one_thread_for_children() -> Iterator[None]:
    """Have processes that are started in the block use one, unless the environment says more."""
    names = _unset()
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name in names:
            del os.environ[name]


def _unset() -> list[str]:
    # The general variable is the user's word for all of them.
    if "OMP_NUM_THREADS" in os.environ:
        return []
    return [name for name in _VARIABLES if name not in os.environ]
