"""Requirements on results for scripts and CI gates, such as `ate.position_m.rmse < 0.3`."""

from __future__ import annotations

import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from trajeval_ros.exceptions import SettingsError

_COMPARISONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
_SHOWN = 4  # longer paths in a message; results can have a hundred
_PATTERN = r"\s*([\w.%]+?)\s*(<=|>=|<|>)\s*([-+0-9.eE]+)\s*"


@dataclass(frozen=True)
class Requirement:
    """A bound on one number of every run in a result."""

    # Keys below the run, joined by dots. A requested sub-trajectory length is a key of `re`:
    # `re.8m.position_percent.mean`, `re.10%.rotation_deg.p95`.
    path: str
    comparison: str  # `<`, `<=`, `>` or `>=`
    bound: float  # in the unit of the number

    @classmethod
    def parse(cls, text: str) -> Requirement:
        """Return the requirement in a text such as `ate.position_m.rmse < 0.3`.

        Raises:
            SettingsError: The text is not PATH, comparison and number.
        """
        match = re.fullmatch(_PATTERN, text)
        try:
            if match is None:
                raise ValueError
            return cls(match[1], match[2], float(match[3]))
        except ValueError:
            raise SettingsError(
                f"the requirement {text!r} is not valid; write it as in 'ate.position_m.rmse < "
                "0.3'"
            ) from None

    def __str__(self) -> str:
        """Return the text that `parse` reads."""
        return f"{self.path} {self.comparison} {self.bound:g}"

    def unmet(self, run: Mapping[str, Any], lengths: Sequence[str]) -> str:
        """Return the reason why a run does not meet the requirement, "" if it does.

        Args:
            run: One of the `runs` of a result.
            lengths: Sub-trajectory lengths as requested: "8m", "10%".

        Raises:
            SettingsError: The path does not exist in results, or is not a number.
        """
        value: Any = run
        for key in self.path.split("."):
            if value is None:
                break
            known = _below(value, lengths)
            if key not in known:
                hint = self._hint(key, known, run, lengths)
                raise SettingsError(f"results have no {key!r} in {self.path!r}{hint}")
            value = known[key]
        if value is None:
            return f"{self} not met: {self.path} was not computed"
        if isinstance(value, bool) or not isinstance(value, int | float):
            hint = ""
            if isinstance(value, Mapping):
                keys = [key for key, item in value.items() if not isinstance(item, str)]
                hint = f"; add one of {', '.join(keys)}"
            raise SettingsError(f"{self.path} is not a number{hint}")
        if _COMPARISONS[self.comparison](value, self.bound):
            return ""
        return f"{self} not met: {value:.6g}"

    def _hint(
        self, key: str, known: Mapping[str, Any], run: Mapping[str, Any], lengths: Sequence[str]
    ) -> str:
        """Return the end of a message: where the path ends a longer one, or the nearest key."""
        longer = [path for path in _paths(run, lengths) if path.endswith(f".{self.path}")]
        if longer:
            more = f" and {len(longer) - _SHOWN} more" if len(longer) > _SHOWN else ""
            return (
                f"; longer paths: {', '.join(longer[:_SHOWN])}{more}, as in --require "
                f"'{longer[0]} {self.comparison} {self.bound:g}'"
            )
        near = get_close_matches(key, known, n=1) or list(known)[:1]
        return f"; did you mean {near[0]!r}?" if near else ""


def _below(value: Any, lengths: Sequence[str]) -> Mapping[str, Any]:
    """Return what a value in a result holds by the keys of paths; empty for no mapping."""
    if not isinstance(value, Mapping):
        return {}
    if "pooled" not in value:
        return value
    # A dot in a length is written as an underscore, since dots separate keys.
    names = [length.replace(".", "_") for length in lengths]
    return {**dict(zip(names, value["segments"], strict=True)), "pooled": value["pooled"]}


def _paths(value: Any, lengths: Sequence[str]) -> Iterator[str]:
    """Yield the paths of all numbers in a result."""
    for key, item in _below(value, lengths).items():
        if isinstance(item, int | float) and not isinstance(item, bool):
            yield key
        yield from (f"{key}.{path}" for path in _paths(item, lengths))
