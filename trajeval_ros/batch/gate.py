"""A regression gate, and its notation on the command line."""

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
_EQUAL = 1e-9  # relative: numbers that differ by less are equal
_LEAST = 1e-12  # smallest error, so that the logarithm of zero is finite
_EXAMPLE = "ate.position_m.rmse worse than 5 %"


@dataclass(frozen=True)
class Gate:
    """A limit of how much worse a number may be than in the baseline.

    Attributes:
        path: Path of the number, as in a requirement: `ate.position_m.rmse`,
            `re.8m.position_percent.mean`, `association.groundtruth_coverage`.
        percent: The margin: the largest permitted worsening, in percent.
        deviations: A single number is worse only if its median also differs by more than this
            many median absolute deviations of the baseline's trials.
        spread_percent: Standard deviation of the trials, in percent, given by the user; None to
            estimate it.
        tested: Whether to apply a statistical test to the trials; if not, medians are compared.
    """

    path: str
    percent: float
    deviations: float = 0.0
    spread_percent: float | None = None
    tested: bool = True

    @classmethod
    def parse(cls, text: str) -> Gate:
        """Parse `ate.position_m.rmse worse than 5 %`; `spread 15 %` or `untested` may follow.

        Raises:
            SettingsError: The text has another form, a spread of 0 %, or a margin of 100 % or more
                for a coverage.
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
        """Return the text that `parse` reads."""
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
    def is_share(self) -> bool:
        """Whether the number is a coverage, from 0 to 1, and not an error."""
        return self.path.startswith("association.")

    @property
    def larger_is_worse(self) -> bool:
        """Whether the number is an error; a coverage is worse if it is smaller."""
        return not self.is_share

    @property
    def margin(self) -> float:
        """The margin as a difference of logarithms, larger by the tolerance of equal numbers."""
        if self.larger_is_worse:
            return math.log1p(self.percent / 100.0) + _EQUAL
        return _EQUAL - math.log1p(-self.percent / 100.0)

    def logarithm(self, value: float) -> float:
        """Return the logarithm of a value, with the sign for which larger is worse.

        Args:
            value: The value; inf for a failed run, which is returned as inf.
        """
        if math.isinf(value):
            return math.inf
        return (1.0 if self.larger_is_worse else -1.0) * math.log(max(value, _LEAST))

    def change(self, logarithm: float) -> float:
        """Convert a change of `logarithm` to a relative change of the number, 0.05 for 5 %."""
        sign = 1.0 if self.larger_is_worse else -1.0
        exponent = sign * logarithm
        return math.expm1(exponent) if exponent < 700.0 else math.inf
