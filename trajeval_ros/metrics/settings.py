"""Conversion of options (command line, ROS parameters) to a protocol."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import gauge_for
from trajeval_ros.metrics.association import INTERPOLATING
from trajeval_ros.metrics.named_protocols import protocol_named
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectory_length import parse_lengths


def protocol_from(
    base: str | Protocol,
    *,
    gauge: str | None = None,
    modality: str | None = None,
    align_states: str | None = None,
    align_with: str | None = None,
    apply: str | None = None,
    align_weights: str | None = None,
    lever_m: tuple[float, float, float] | None = None,
    association: str | None = None,
    max_time_difference: float | None = None,
    max_gap: float | None = None,
    time_offset: float | None = None,
    continuous_model: str | None = None,
    groundtruth_noise: tuple[float, float] | None = None,
    lengths: str | None = None,
    pairs: str | None = None,
    ate_form: str | None = None,
    re_form: str | None = None,
) -> Protocol:
    """Return a protocol with some settings replaced; None keeps a setting.

    Args:
        base: The protocol, or its name.
        gauge: Name of the gauge.
        modality: Sensor set, which determines the gauge.
        align_states: `all`, or a number.
        align_with: `positions` or `poses`.
        apply: `all`, or the alignment's `scale` alone.
        align_weights: See `Protocol`.
        lever_m: Position of the groundtruth's point in the estimate's body, metres.
        association: Method of the association.
        max_time_difference: Seconds.
        max_gap: Seconds.
        time_offset: Added to the estimate's timestamps, seconds.
        continuous_model: Motion model of the groundtruth, for association continuous.
        groundtruth_noise: Standard deviations of its samples (m, deg), for association continuous.
        lengths: "8,16,24", "1s,5s", "10f", "5deg", "10%,20%" or "none".
        pairs: `all` or `consecutive` sub-trajectories.
        ate_form: See `Protocol`.
        re_form: See `Protocol`.

    Raises:
        SettingsError: An unknown value, or settings that exclude one another.
    """
    base = protocol_named(base) if isinstance(base, str) else base
    method = association or base.association.method
    if max_time_difference is not None and method in INTERPOLATING:
        raise SettingsError(
            f"association {method} interpolates and has no max time difference; use association "
            "nearest, or set a max gap"
        )
    if method != "continuous":
        if continuous_model is not None:
            raise SettingsError(f"--continuous-model needs --association continuous, not {method}")
        groundtruth_noise = None
    rule = _replaced(
        base.association,
        method=association,
        model=continuous_model,
        noise=None
        if groundtruth_noise is None
        else Noise(groundtruth_noise[0], math.radians(groundtruth_noise[1])),
        max_time_difference_s=max_time_difference,
        max_gap_s=max_gap,
        time_offset_s=time_offset,
    )
    if gauge is not None or modality is not None:
        # The modality of the base is replaced together with its gauge.
        chosen = gauge_for(gauge, modality, base.gauge)
        base = dataclasses.replace(base, gauge=chosen, modality=modality)
    protocol: Protocol = _replaced(
        base,
        association=rule,
        lengths=None if lengths is None else parse_lengths(lengths),
        selection=_replaced(base.selection, pairs=pairs),
        ate_form=ate_form,
        re_form=re_form,
    )
    # In one step: a setting can be valid only together with another one.
    return dataclasses.replace(
        protocol,
        align_states=protocol.align_states if align_states is None else parse_states(align_states),
        align_with=align_with or protocol.align_with,
        apply=apply or protocol.apply,
        align_weights=align_weights or protocol.align_weights,
        lever_m=protocol.lever_m if lever_m is None else lever_m,
    )


def parse_states(text: str) -> int | None:
    """Read "all" or a number of states."""
    if text == "all":
        return None
    if not text.isdecimal() or int(text) < 1:
        raise SettingsError(f"align states must be all or a number of states, not {text!r}")
    return int(text)


def _replaced(base: Any, **changes: Any) -> Any:
    return dataclasses.replace(
        base, **{name: value for name, value in changes.items() if value is not None}
    )
