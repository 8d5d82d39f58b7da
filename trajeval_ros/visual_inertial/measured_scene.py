"""Measured keyframes for the gauge study: one problem, with a new initial state in every trial."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.visual_inertial.initial_state import initial_state
from trajeval_ros.visual_inertial.outliers import Rejection
from trajeval_ros.visual_inertial.problem import Problem
from trajeval_ros.visual_inertial.state import State


@dataclass(frozen=True, eq=False)
class MeasuredScene:
    """The problem of the gauge study; trials only differ in their initial state.

    Attributes:
        problem: The measurements.
        truth: Groundtruth of the keyframes, and the landmarks of the solution without outliers,
            since their true positions are unknown.
    """

    problem: Problem
    truth: State

    @classmethod
    def of(cls, rejection: Rejection) -> MeasuredScene:
        """Return the scene of the measurements without outliers."""
        truth = dataclasses.replace(rejection.selection.truth, landmarks=rejection.state.landmarks)
        return cls(rejection.selection.problem(), truth)

    def measured(self, generator: np.random.Generator) -> Problem:  # noqa: ARG002
        """Return the problem: there is one set of measurements."""
        return self.problem

    def disturbed(self, generator: np.random.Generator) -> State:
        """Return a random initial state (gauge paper, section V-B)."""
        return initial_state(self.truth, generator)
