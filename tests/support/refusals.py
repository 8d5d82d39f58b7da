"""Whether something is refused, for tables of good and bad values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trajeval_ros.exceptions import InputError, SettingsError


def is_refused(
    call: Callable[..., object],
    *values: Any,
    error: type[Exception] | tuple[type[Exception], ...] = (InputError, SettingsError),
    **more: Any,
) -> bool:
    """Return whether a call raises an error of the user's input, or a given one."""
    try:
        call(*values, **more)
    except error:
        return True
    return False
