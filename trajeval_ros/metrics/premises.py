"""What errors rely on. The fields of `AbsoluteErrors` and `RelativeErrors` declare it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeVar

Errors = TypeVar("Errors")


class Premise(Enum):
    """A condition that must hold for an error to have a meaning."""

    ORIENTATIONS = "both sides have orientations"
    ROLL_AND_PITCH = "both sides have roll and pitch"
    HEIGHT = "both sides have a height"
    UP_AXIS = "the groundtruth's up axis is vertical"
    RELATIVE_UP_AXIS = "likewise, for relative errors"
    BODY_ROTATION = "the orientations of both sides are those of the same body"
    ALIGNMENT_ROTATION = "the alignment's rotation is determined"
    DIRECTIONS = "that rotation does not change the direction of position errors"
    FIRST_STATES = "sub-trajectories can be aligned at their first states"


# Without these, a quantity does not exist, so that tables have no row for it.
_EXISTENCE = {Premise.ORIENTATIONS, Premise.ROLL_AND_PITCH, Premise.HEIGHT}


def relies_on(*premises: Premise, required: bool = False) -> Any:
    """Return a dataclass field for errors that rely on premises; None unless `required`."""
    default = dataclasses.MISSING if required else None
    return dataclasses.field(default=default, metadata={"premises": premises})


@dataclass(frozen=True)
class Doubts:
    """The premises that do not hold, with reasons."""

    reasons: Mapping[Premise, str] = dataclasses.field(default_factory=dict)

    def withheld(self, kind: type) -> dict[str, str]:
        """Return the reasons by withheld metric; `kind` is a dataclass of errors."""
        withheld: dict[str, str] = {}
        if not self.reasons:
            return withheld
        for column in dataclasses.fields(kind):
            failed = [p for p in column.metadata.get("premises", ()) if p in self.reasons]
            if failed:
                withheld[column.name] = self.reasons[failed[0]]
        return withheld

    def about(self, kind: type, metric: str) -> str:
        """Return why a metric is withheld; empty if it is reported."""
        return self.withheld(kind).get(metric, "")

    def without(self, errors: Errors) -> Errors:
        """Return errors, a dataclass, with None in place of withheld columns."""
        absent: dict[str, Any] = dict.fromkeys(self.withheld(type(errors)))
        return dataclasses.replace(errors, **absent)  # type: ignore[type-var]

    @property
    def of_existing(self) -> Doubts:
        """The doubts about quantities that exist."""
        return Doubts({p: why for p, why in self.reasons.items() if p not in _EXISTENCE})
