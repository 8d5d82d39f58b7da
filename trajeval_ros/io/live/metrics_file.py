"""The numbers of a live run as an OpenMetrics text file, for other programs to read."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trajeval_ros.io.writing import write_text

NAME = "metrics.prom"


def write_metrics(folder: Path, statuses: Mapping[str, Mapping[str, Any]]) -> None:
    """Replace the file in a run's folder by the newest values of all estimates, atomically.

    `statuses` has values by name and unit, by the name of the estimate; only finite numbers are
    written. An InputError is raised if that is not possible.
    """
    write_text(folder / NAME, open_metrics(statuses))


def open_metrics(statuses: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the text: one gauge per quantity, with the estimate as its label.

    Prometheus's older text format reads it, too: it has the same lines for gauges.
    """
    samples: dict[str, list[str]] = {}
    for estimate, values in statuses.items():
        label = estimate.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
        for key, value in values.items():
            if isinstance(value, int | float) and math.isfinite(value):
                name = f"trajeval_{re.sub(r'[^a-z0-9]+', '_', key.lower()).strip('_')}"
                samples.setdefault(name, []).append(
                    f'{name}{{estimate="{label}"}} {float(value)!r}'
                )
    lines = [line for name, of in samples.items() for line in (f"# TYPE {name} gauge", *of)]
    return "\n".join([*lines, "# EOF", ""])
