"""Many runs to compare: text files of 10 algorithms, and the file that names them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

ALGORITHMS = 10


def write_runs(
    config: Path, sequences: int, trials: int, poses: int, settings: Sequence[str]
) -> Path:
    """Write runs, if they aren't there yet, and what compares them; return that.

    Args:
        config: The file to write; runs are in folders beside it.
        sequences: Number of sequences.
        trials: Of each algorithm on each of them.
        poses: Of each run.
        settings: Lines of the file beside those that name the runs.
    """
    import numpy as np

    from benchmarks.tum_pairs import OFFSET_NS, RATE_HZ, START_NS, estimate_of, flight, write_tum

    folder = config.parent
    stamps = START_NS + np.arange(poses, dtype=np.int64) * int(1e9 / RATE_HZ)
    (folder / "groundtruth").mkdir(parents=True, exist_ok=True)
    for sequence in range(sequences):
        positions, attitudes = flight(np.random.default_rng(sequence), poses)
        truth = folder / "groundtruth" / f"s{sequence}.txt"
        if not truth.exists():
            write_tum(truth, stamps, positions, attitudes)
        for algorithm in range(ALGORITHMS):
            (folder / f"a{algorithm}").mkdir(exist_ok=True)
            for trial in range(trials):
                path = folder / f"a{algorithm}" / f"s{sequence}_{trial}.txt"
                if not path.exists():
                    seed = np.random.default_rng([sequence, algorithm, trial])
                    estimate = estimate_of(seed, positions, attitudes)
                    write_tum(path, stamps + OFFSET_NS, *estimate)
    names = [f"  a{index}: a{index}/{{sequence}}_{{trial}}.txt" for index in range(ALGORITHMS)]
    listed = ", ".join(map(str, range(trials)))
    lines = ["groundtruth: groundtruth/{sequence}.txt", *settings, "runs:", *names]
    config.write_text("\n".join([*lines, f"trials: [{listed}]", ""]))
    return config
