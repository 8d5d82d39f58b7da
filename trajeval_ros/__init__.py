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

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol
from trajeval_ros.pipeline import evaluate

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
