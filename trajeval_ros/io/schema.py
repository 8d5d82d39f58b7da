"""The layouts of result files, each of which a file names: `trajeval-runs/1`.

The number is raised when something that was there goes, or means something else, and not when
something is added.
"""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.exceptions import InputError


def require_schema(path: Path, found: object, known: str, what: str, mend: str) -> None:
    """Check that a file has the layout that is read.

    Args:
        path: The file.
        found: What it says.
        known: What is read.
        what: What such a file is, for the message.
        mend: What to do about another file.

    Raises:
        InputError: It is something else, or of another version.
    """
    if found == known:
        return
    family = known.rpartition("/")[0]
    if isinstance(found, str) and found.startswith(f"{family}/"):
        raise InputError(
            f"{path} has schema {found}, and this version reads {known}; {mend}, or use the "
            "version that wrote it"
        )
    raise InputError(f"{path} is not a {what} ({known}); {mend}")
