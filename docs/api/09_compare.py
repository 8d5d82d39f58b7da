"""Compare algorithms x sequences x trials; the report and all tables are in a folder."""

import tempfile
from pathlib import Path

import numpy as np

from trajeval_ros import Trajectory, compare, simulate

CONFIG = """
groundtruth: truth/{sequence}.txt
runs:
  vio: vio/{sequence}_{trial}.txt
  slam: slam/{sequence}_{trial}.txt
modality: stereo-inertial
"""


def write_tum(path: Path, states: Trajectory) -> None:
    """Write `stamp x y z qx qy qz qw`: seconds, metres, quaternion."""
    path.parent.mkdir(exist_ok=True)
    rows = np.column_stack([states.stamps * 1e-9, states.positions, states.quaternions])
    np.savetxt(path, rows, fmt="%.9f")


if __name__ == "__main__":  # runs are evaluated in processes, which import this file
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for sequence in (1, 2):
            flight = simulate(seed=sequence, duration_s=40.0)
            write_tum(folder / f"truth/room{sequence}.txt", flight.groundtruth[::10])
            write_tum(folder / f"vio/room{sequence}_0.txt", flight.estimate)
            write_tum(folder / f"slam/room{sequence}_0.txt", flight.estimate[::2])
        (folder / "runs.yaml").write_text(CONFIG)
        summary = compare(folder / "runs.yaml", folder / "out", workers=1, lengths="8,16")
        for trial in summary.trials:
            print(trial.algorithm, trial.sequence, trial.status, trial.rmse["position_m"], "m")
        print(sorted(path.name for path in (folder / "out").iterdir()))
