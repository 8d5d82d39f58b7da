"""Evaluate VIO and SLAM trajectories, live and recorded, with one set of definitions.

from trajeval_ros import Gauge, Protocol, evaluate
from trajeval_ros.io.sources import read_trajectory

evaluation = evaluate(
    read_trajectory("groundtruth.txt"),
    read_trajectory("run.mcap:/vio/odometry"),
    Protocol(gauge=Gauge.YAW),
)
print(evaluation.ate["position_m"].rmse)
"""

__version__ = "0.1.0"

from trajeval_ros.evaluation import Evaluation, evaluate
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.gauge import MODALITIES, Gauge
from trajeval_ros.protocol import PROTOCOLS, Protocol
from trajeval_ros.trajectory import Trajectory

__all__ = [
    "MODALITIES",
    "PROTOCOLS",
    "Evaluation",
    "Gauge",
    "Protocol",
    "Trajectory",
    "TrajevalError",
    "evaluate",
]
