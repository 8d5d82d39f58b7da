"""Check of the schema that a result file names, such as `trajeval-runs/1`.

The number is the version. It is raised when a field is removed or changes its meaning, and not
when a field is added.
"""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.exceptions import InputError


def require_schema(path: Path, found: object, known: str, what: str, mend: str) -> None:
    """Check that a file has the supported schema.

    Args:
        path: The file.
        found: Schema that the file names.
        known: Supported schema, `NAME/VERSION`.
        what: Description of such a file, for the message.
        mend: Advice for the message.

    Raises:
        InputError: The file has another schema or another version of it.
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
