"""Settings that have no effect on the data."""

from __future__ import annotations

from collections.abc import Mapping


def about_unused(
    given: object, default: object, options: Mapping[str, str], why: str
) -> list[str]:
    """Return the warning about settings that differ from the default without an effect.

    Args:
        given: The settings.
        default: Settings of the same type.
        options: Option of the command line by attribute of the settings.
        why: Reason, and what to do.
    """
    unused = [
        option
        for name, option in options.items()
        if getattr(given, name) != getattr(default, name)
    ]
    return [f"no effect of {', '.join(unused)}: {why}"] if unused else []
