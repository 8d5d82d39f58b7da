"""The paper's own density of residuals, Gaussian in logarithms, to compare with its numbers."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.likelihood.residuals import Residuals


@dataclass(frozen=True, eq=False)
class PaperResiduals(Residuals):
    @property
    def curved(self) -> bool:
        return False


DENSITIES = {"haar": Residuals, "log": PaperResiduals}
