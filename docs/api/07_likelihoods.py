"""Likelihoods and Bayes factors: which estimate does a slow groundtruth speak for?"""

import math
from dataclasses import replace

import numpy as np

from trajeval_ros import (
    AssociationRule,
    Noise,
    Protocol,
    Request,
    assess_likelihood,
    evaluate,
    run,
    simulate,
)

flight = simulate(seed=1, duration_s=30.0)
slow = flight.groundtruth[::100]
random = np.random.default_rng(1)


def disturbed(sigma_m: float, name: str):
    """Return every tenth true pose with errors of so many metres."""
    poses = flight.groundtruth[::10]
    errors = sigma_m * random.normal(size=poses.positions.shape)
    return replace(poses, positions=poses.positions + errors, name=name)


good, bad = disturbed(0.01, "good"), disturbed(0.05, "bad")
rule = AssociationRule("continuous", model="wnoj", noise=Noise(0.002, math.radians(0.1)))
protocol = Protocol(modality="stereo-inertial", association=rule, lengths=())

alone = assess_likelihood(evaluate(slow, good, protocol))
print("ATE of poses with known groundtruth:", alone.ate.supported_m, alone.ate.supported_share)

outcome = run(slow, [good, bad], Request(protocol))
for item in outcome.runs:
    print(item.estimate.name, "log Bayes factor, nats:", item.likelihood.log_bayes)
