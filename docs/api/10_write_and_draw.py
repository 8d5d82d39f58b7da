"""Write result.json and errors.npz, draw one figure, and tell mistakes from defects."""

import json
import tempfile
from pathlib import Path

import numpy as np

from trajeval_ros import (
    Protocol,
    Request,
    TrajevalError,
    draw,
    read_trajectory,
    run,
    simulate,
    write_result,
)

flight = simulate(seed=1, duration_s=60.0)
outcome = run(flight.groundtruth, [flight.estimate], Request(Protocol(modality="stereo-inertial")))
print(outcome)

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    result = json.loads(write_result(outcome, folder).read_text())
    with np.load(folder / "errors.npz") as errors:
        print(len(errors.files), "columns; of them", errors.files[:3])
    draw(outcome.runs[0].evaluation, "absolute", folder / "absolute.png")
    print(result["runs"][0]["ate"]["position_m"]["rmse"], sorted(p.name for p in folder.iterdir()))
    try:
        read_trajectory(folder / "reslut.json")
    except TrajevalError as error:  # one sentence: what, where, how to correct it
        print(str(error).replace(name, "FOLDER"))
