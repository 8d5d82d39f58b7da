"""What associations report against slow groundtruth, as a table of docs/probabilistic.md.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.associations [FLIGHTS]

Flights are those of `tests/support/flights.py`: 2 m/s, groundtruth at 2 Hz that is lost three
times, and three estimates whose ATEs are about 1, 3 and 10 cm. Of each association
the table has the medians of reported by true ATE, and the share of the estimates' poses that it is
of.
"""

from __future__ import annotations

import sys

import numpy as np

from tests.support.flights import DRIFTS_M, fly
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.papers.association_study import ReportedAte, compare_associations

FLIGHTS = 40
PROTOCOL = Protocol(gauge=Gauge.SE3, association=AssociationRule("continuous"), lengths=())


def numbers(reported: ReportedAte, true_m: float) -> tuple[float, float, float]:
    """Return the ATE, metres, by how much it is the true one, and its share of the poses."""
    ate_m = np.nan if reported.ate_m is None else reported.ate_m
    return ate_m, ate_m / true_m, reported.share


def main() -> None:
    """Print the table as Markdown."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else FLIGHTS
    rows: dict[str, list[list[tuple[float, float, float]]]] = {}
    for seed in range(count):
        flight = fly(seed)
        compared = [
            compare_associations(flight.truth, flight.groundtruth, estimate, PROTOCOL)
            for estimate in flight.estimates
        ]
        for same in zip(*(one.reported for one in compared), strict=True):
            row = [numbers(item, of.true_ate_m) for item, of in zip(same, compared, strict=True)]
            rows.setdefault(same[0].association, []).append(row)
    sizes = " | ".join(f"{100.0 * size:g} cm, of poses" for size in DRIFTS_M)
    print(f"| association | {sizes} | right order |")
    print("|---|" + "---|" * (len(DRIFTS_M) + 1))
    for name, every in rows.items():
        ates_m, times, shares = np.moveaxis(np.array(every), -1, 0)
        right = float(np.mean((np.diff(ates_m, axis=1) > 0.0).all(axis=1)))
        cells = [
            f"{ratio:.3g}, {100.0 * share:.0f} %"
            for ratio, share in zip(np.nanmedian(times, 0), np.median(shares, 0), strict=True)
        ]
        print(f"| {name} | {' | '.join(cells)} | {100.0 * right:.0f} % |")


if __name__ == "__main__":
    main()
