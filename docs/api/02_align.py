"""Align by a gauge of your choice, with weights, by a transform that you know, or not at all."""

import numpy as np

from trajeval_ros import Gauge, Protocol, Similarity, align, evaluate, simulate

flight = simulate(seed=1, duration_s=60.0)
groundtruth, estimate = flight.groundtruth, flight.estimate

for gauge in Gauge:
    evaluation = evaluate(groundtruth, estimate, Protocol(gauge=gauge, lengths=()))
    print(f"{gauge.value:12} {evaluation.ate['position_m'].rmse:8.3f} m  {gauge.description}")

# The same alignment by hand, with weights: the pairs of the first 10 s count ten times.
pairs = evaluation.association
weights = np.where(pairs.estimate.seconds < 10.0, 10.0, 1.0)
alignment = align("yaw", pairs.groundtruth.positions, pairs.estimate.positions, weights)
print("translation, m:", alignment.similarity.translation)

# A transform of your own: groundtruth frame from estimate frame.
fitted = alignment.similarity
known = Similarity(rotation=fitted.rotation, translation=fitted.translation)
moved = known.trajectory(estimate)
errors = evaluate(groundtruth, moved, Protocol(gauge="none", lengths=()))
print("under the known transform:", errors.ate["position_m"].rmse, "m")
