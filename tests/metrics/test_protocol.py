"""Settings are checked where they are made: names, gauges beside modalities, lengths."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.io.requests.request_from import protocol_from
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol, metres
from trajeval_ros.metrics.sub_trajectories import Length, Selection


@pytest.mark.parametrize("gauge", Gauge)
def test_a_gauge_may_be_named(gauge: Gauge) -> None:
    assert Protocol(gauge=gauge.value) == Protocol(gauge=gauge)


def test_texts_and_numbers_are_accepted() -> None:
    protocol = Protocol(association="nearest", lengths=[8, 16.0, "1s", "10%"], selection="toolbox")
    assert protocol.association == AssociationRule("nearest")
    assert protocol.selection == Selection("toolbox")
    assert protocol.lengths == (*metres(8, 16), Length(1.0, "s"), Length(10.0, "%"))
    assert Protocol(lengths="8,1s").lengths == (Length(8.0, "m"), Length(1.0, "s"))
    assert Protocol(lengths="none").lengths == ()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"modality": "nonsense"}, "unknown modality 'nonsense'; use one of mono, stereo"),
        ({"modality": "mono-inertail"}, "did you mean mono-inertial?"),
        ({"gauge": "yaw", "modality": "mono"}, "modality mono means gauge sim3, not yaw"),
        ({"gauge": "ywa"}, "did you mean yaw?"),
        ({"gauge": 3}, "unknown gauge 3"),
        ({"association": "liner"}, "did you mean linear?"),
        ({"selection": "toolbx"}, "did you mean toolbox?"),
        ({"ate_form": "plane"}, "did you mean plain?"),
        ({"re_form": "sE3"}, "unknown RE form 'sE3'"),
        ({"align_weights": "covariances"}, "did you mean covariance?"),
        ({"lengths": (8, "banana")}, "'banana' is not a length"),
        ({"lengths": (8, None)}, "None is not a length"),
        ({"lengths": (float("nan"),)}, "a length must be positive"),
        ({"lengths": (True,)}, "True is not a length"),
        ({"lengths": 8}, "lengths must be a sequence"),
        ({"align_states": 0}, "at least 1, not 0"),
        ({"align_states": "all"}, "at least 1, not 'all'"),
        ({"lever_m": (1.0, 2.0)}, "a lever arm must be three numbers"),
    ],
)
def test_what_means_nothing_is_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError) as caught:
        Protocol(**settings)
    assert words in str(caught.value)


def test_variants_keep_gauge_and_modality_together() -> None:
    inertial = Protocol(modality="mono-inertial")
    assert dataclasses.replace(inertial, lengths=()).gauge is Gauge.YAW
    with pytest.raises(SettingsError, match="give only one"):
        dataclasses.replace(inertial, gauge=Gauge.SE3)
    mono: Any = dataclasses.replace(inertial, gauge=None, modality="mono")
    assert (mono.gauge, mono.modality) == (Gauge.SIM3, "mono")


def test_a_gauge_by_word_replaces_the_modality_of_a_protocol() -> None:
    inertial = Protocol(modality="mono-inertial")
    changed = protocol_from(inertial, gauge="se3")
    assert (changed.gauge, changed.modality) == (Gauge.SE3, None)
    assert protocol_from(inertial, lengths="none").modality == "mono-inertial"


def test_protocols_of_programs_that_dont_sort_dont() -> None:
    unsorted = {name for name, protocol in PROTOCOLS.items() if not protocol.in_order}
    assert unsorted == {"rpg", "evo", "kitti", "hilti-2022", "hilti-2023"}
