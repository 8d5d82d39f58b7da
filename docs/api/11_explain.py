"""Find the definition that gives a published number."""

from trajeval_ros import evaluate, explain, simulate

flight = simulate(seed=1, duration_s=60.0)
published = f"{evaluate(flight.groundtruth, flight.estimate).ate['position_m'].rmse:.5f}"

explanation = explain([(flight.groundtruth, flight.estimate, [published])], unit="m")
print(explanation.verdict, published)
for match in explanation.matches[:3]:
    print(match.definitions[0])
