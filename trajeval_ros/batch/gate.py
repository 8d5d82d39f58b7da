"""What a regression gate is, and how it is written on the command line."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError

_SIZE = r"(\d+\.?\d*|\.\d+)"
_GATE = re.compile(
    r"\s*([\w.%]+)\s+worse\s+than\s+(.+?)"
    rf"(?:\s+spread\s+{_SIZE}\s*%|\s+(untested))?\s*"
)
_TERM = re.compile(rf"{_SIZE}\s*(%|MAD)")
_EQUAL = 1e-9  # relative: the digits that are promised
_LEAST = 1e-12  # of an error, so that zero has a logarithm
_EXAMPLE = "ate.position_m.rmse worse than 5 %"


@dataclass(frozen=True)
class Gate:
    """How much worse a number may be than in the baseline.

    Attributes:
        path: As in a requirement: `ate.position_m.rmse`, `re.8m.position_percent.mean`,
            `association.groundtruth_coverage`.
        percent: The margin: what may change.
        deviations: Median absolute deviations of the baseline's trials, beyond which the median of
            a single number must be, too.
        spread_percent: Of the trials, where the user knows it; None to measure it.
        tested: Whether trials tell a change from chance; else medians alone decide.
    """

    path: str
    percent: float
    deviations: float = 0.0
    spread_percent: float | None = None
    tested: bool = True

    @classmethod
    def parse(cls, text: str) -> Gate:
        """Read `ate.position_m.rmse worse than 5 %`, perhaps with `spread 15 %` or `untested`.

        Raises:
            SettingsError: It is written otherwise, or can't be judged.
        """
        match = _GATE.fullmatch(text)
        terms = [_TERM.fullmatch(each.strip()) for each in match[2].split("+")] if match else []
        sizes: dict[str, float] = {}
        for term in terms:
            if term is None or term[2] in sizes:
                break
            sizes[term[2]] = float(term[1])
        if match is None or len(sizes) != len(terms):
            raise SettingsError(f"the gate {text!r} is not valid; write it as in {_EXAMPLE!r}")
        spread = None if match[3] is None else float(match[3])
        if spread == 0.0:
            raise SettingsError(
                f"the gate {text!r} has a spread of 0 %; if trials do not vary, write 'untested'"
            )
        made = cls(match[1], sizes.get("%", 0.0), sizes.get("MAD", 0.0), spread, not match[4])
        if not made.larger_is_worse and made.percent >= 100.0:
            raise SettingsError(f"the margin of a coverage must be below 100 %, not {text!r}")
        return made

    def __str__(self) -> str:
        """Write it as `parse` reads it."""
        terms = []
        if self.percent or not self.deviations:
            terms.append(f"{self.percent:g} %")
        if self.deviations:
            terms.append(f"{self.deviations:g} MAD")
        more = "" if self.tested else " untested"
        if self.spread_percent is not None:
            more = f" spread {self.spread_percent:g} %"
        return f"{self.path} worse than {' + '.join(terms)}{more}"

    @property
    def larger_is_worse(self) -> bool:
        """Whether it is an error, and not a coverage."""
        return not self.path.startswith("association.")

    @property
    def margin(self) -> float:
        """The margin as a logarithm, with the digits that are promised."""
        if self.larger_is_worse:
            return math.log1p(self.percent / 100.0) + _EQUAL
        return _EQUAL - math.log1p(-self.percent / 100.0)

    def logarithm(self, value: float) -> float:
        """Return a logarithm that is larger where the number is worse; inf of a failed run."""
        if math.isinf(value):
            return math.inf
        return (1.0 if self.larger_is_worse else -1.0) * math.log(max(value, _LEAST))

    def change(self, logarithm: float) -> float:
        """Return the relative change of the number, 0.05 for 5 %, of a change of its logarithm."""
        sign = 1.0 if self.larger_is_worse else -1.0
        exponent = sign * logarithm
        return math.expm1(exponent) if exponent < 700.0 else math.inf
