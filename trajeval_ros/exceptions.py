"""Errors that a user can correct.

Every message states where, what is wrong and what to do. The command line prints only the message
and exits with status 2. A traceback is always a defect of this package.
"""

from collections.abc import Iterable


class TrajevalError(Exception):
    """Base of all errors that this package raises on purpose.

    Example:
        >>> from trajeval_ros import Protocol, TrajevalError
        >>> try:
        ...     Protocol(gauge="ywa")
        ... except TrajevalError as error:
        ...     print(str(error).split(";")[0])
        unknown gauge 'ywa' (did you mean yaw?)
    """


class InputError(TrajevalError):
    """A file, bag, topic or trajectory that can't be used.

    Example:
        >>> from trajeval_ros import InputError, read_trajectory
        >>> try:
        ...     read_trajectory("/no/such/file.txt")
        ... except InputError as error:
        ...     print(str(error).split(",")[0])
        /no/such/file.txt does not exist
    """


class SettingsError(TrajevalError):
    """Settings that contradict each other, or a value out of range.

    Example:
        >>> from trajeval_ros import Protocol, SettingsError
        >>> try:
        ...     Protocol(gauge="yaw", modality="mono")
        ... except SettingsError as error:
        ...     print(error)
        modality mono means gauge sim3, not yaw; give only one
    """


class DegenerateGeometryError(TrajevalError):
    """The states don't determine the alignment of the gauge."""


class NoMatchError(InputError):
    """No pose of the estimate is paired with groundtruth.

    Example:
        >>> from dataclasses import replace
        >>> from trajeval_ros import NoMatchError, evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> later = replace(flight.estimate, stamps=flight.estimate.stamps + 10**12)
        >>> try:
        ...     evaluate(flight.groundtruth, later)
        ... except NoMatchError as error:
        ...     print(len(str(error)) > 20)
        True
    """


def require_one_of(value: object, known: Iterable[str], what: str) -> None:
    """Refuse an unknown name of a `what`, with a similar one in the message."""
    known = list(known)
    if isinstance(value, str) and value in known:
        return
    from difflib import get_close_matches

    near = get_close_matches(value.lower(), known, n=1) if isinstance(value, str) else []
    hint = f" (did you mean {near[0]}?)" if near else ""
    raise SettingsError(f"unknown {what} {value!r}{hint}; use one of {', '.join(known) or 'none'}")


def describe_defect(error: Exception) -> str:
    """Return an exception that is a defect of this package, in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def reason_of(error: OSError) -> str:
    """Return the system's description of an error, as part of a sentence."""
    return (error.strerror or str(error)).lower()
