"""Evaluate while states arrive, and check that the end agrees with the recorded evaluation."""

from trajeval_ros import OnlineEvaluator, OnlineSettings, Protocol, evaluate, simulate

flight = simulate(seed=1, duration_s=60.0)
protocol = Protocol(modality="stereo-inertial", lengths=(8,))
live = OnlineEvaluator(OnlineSettings(protocol, window="30s"))

truth, estimate = flight.groundtruth, flight.estimate
for begin in range(int(truth.stamps[0]), int(truth.stamps[-1]) + 1, 1_000_000_000):
    for states, add in ((truth, live.add_groundtruth), (estimate, live.add_estimate)):
        new = states[(states.stamps >= begin) & (states.stamps < begin + 1_000_000_000)]
        add(new)
    update = live.update()
    if update.stamp is not None and update.ends:
        print(f"{update.pairs} pairs, now {update.position_m:.3f} m, {len(update.ends)} ends")
live.update(at_end=True)

snapshot = live.snapshot()
recorded = evaluate(truth, estimate, protocol).ate["position_m"]
print("pairs:", snapshot.pairs, "recorded:", recorded.count)
print("ATE, m:", snapshot.position_rmse_m, "recorded:", recorded.rmse)
print("of the last 30 s:", snapshot.ate["position_m"])
assert snapshot.pairs == recorded.count
