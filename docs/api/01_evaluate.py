"""Read two text files, align by what the sensors can't observe, and measure the errors."""

import tempfile
from pathlib import Path

import numpy as np

from trajeval_ros import MODALITIES, Protocol, Trajectory, evaluate, read_many, simulate


def write_tum(path: Path, states: Trajectory) -> Path:
    """Write `stamp x y z qx qy qz qw`: seconds, metres, quaternion."""
    rows = np.column_stack([states.stamps * 1e-9, states.positions, states.quaternions])
    np.savetxt(path, rows, fmt="%.9f")
    return path


with tempfile.TemporaryDirectory() as folder:
    flight = simulate(seed=1, duration_s=60.0)
    paths = [
        write_tum(Path(folder) / "groundtruth.txt", flight.groundtruth),
        write_tum(Path(folder) / "estimate.txt", flight.estimate),
    ]
    groundtruth, estimate = read_many(paths)  # also BAG:TOPIC and BAG:/tf:PARENT.CHILD

print(groundtruth, estimate)
for modality in ("stereo", "stereo-inertial"):
    evaluation = evaluate(groundtruth, estimate, Protocol(modality=modality))
    position, rotation = evaluation.ate["position_m"], evaluation.ate["rotation_deg"]
    print(modality, MODALITIES[modality], position.rmse, "m", rotation.rmse, "deg")
print(evaluation)
columns = evaluation.to_columns()  # to_arrow() and to_pandas() give tables
print({name: column.shape for name, column in columns.items()})
