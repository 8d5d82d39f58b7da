"""Relative errors over lengths of your own, and by the rules of other tools."""

from dataclasses import replace

from trajeval_ros import PROTOCOLS, Length, Protocol, evaluate, simulate

flight = simulate(seed=1, duration_s=60.0)
groundtruth, estimate = flight.groundtruth, flight.estimate

# Metres as numbers; seconds and shares of the path as texts.
protocol = Protocol(modality="stereo-inertial", lengths=(5, 10.0, "2s", "10%", Length(20, "m")))
evaluation = evaluate(groundtruth, estimate, protocol)
for item in evaluation.relative:
    position = item.statistics["position_m"]
    print(f"{item.length!s:>4}: rmse {position.rmse:.3f} m over {position.count} sub-trajectories")
print("drift:", evaluation.drift)
ends = evaluation.to_columns("5m")["ends"]
print("the first sub-trajectory of 5 m ends at pair", ends[0])

# The numbers of rpg_trajectory_evaluation, for yaw.
rpg = replace(PROTOCOLS["rpg"], gauge=None, modality="stereo-inertial")
for item in evaluate(groundtruth, estimate, rpg).relative:
    print(f"rpg, {item.length_m:.2f} m: {item.statistics['position_m'].mean:.3f} m in the mean")
