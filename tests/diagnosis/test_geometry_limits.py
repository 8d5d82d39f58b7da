"""Scales, vertical axes, bodies and lever arms of exact short motions, at the limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trajeval_ros.diagnosis.geometry_tests import body, lever_arm, scale, scale_of, vertical

from trajeval_ros.diagnosis.findings import Examined, Seen
from trajeval_ros.diagnosis.hypotheses import Hypothesis, ShortMotions, fit_as_read
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import UpAxis

COUNT = 600
TURN = Rotation.from_rotvec([0.3, -0.5, 0.9])
UPS: Any = (UpAxis(), UpAxis())


def motions(
    *,
    world: Rotation | None = None,
    bodies: Rotation | None = None,
    turned: Rotation | None = None,
    lever: Any = (0.0, 0.0, 0.0),
    metres: Any = 1.0,
    oriented: bool = True,
    size: float = 1.0,
) -> ShortMotions:
    """Return motions of lengths 1 to 2 of a body that turns about all axes.

    The groundtruth is of another world, and of a body that is rotated and at a lever arm; its
    displacements are `metres` times those of the estimate, of one number or of each motion.
    """
    generator = np.random.default_rng(7)
    steps = generator.normal(size=(COUNT, 3))
    steps *= (
        size * (1.0 + np.arange(COUNT) / COUNT)[:, None] / np.linalg.norm(steps, axis=1)[:, None]
    )
    ends = turned or Rotation.random(2 * COUNT, random_state=5)
    world, bodies = world or Rotation.identity(), bodies or Rotation.identity()
    start, end = ends[:COUNT], ends[COUNT:]
    swing = end.apply(lever) - start.apply(lever)
    true = world.apply(steps * np.broadcast_to(metres, COUNT)[:, None] + swing)
    own_turned = np.stack([start.as_quat(), end.as_quat()])
    true_turned = np.stack([(world * each * bodies).as_quat() for each in (start, end)])
    zero = np.zeros((COUNT, 3))
    return ShortMotions(
        np.zeros((COUNT, 2), dtype=np.int64),
        np.stack([zero, true]),
        np.stack([zero, steps]),
        true_turned if oriented else None,
        own_turned if oriented else None,
    )


def as_read(moving: ShortMotions, /, **changed: Any) -> Hypothesis:
    found = vars(fit_as_read(moving, moving))
    return Hypothesis(**{**found, **changed})


def only(found: Examined) -> Seen:
    [seen] = found.seen
    return seen


def test_the_scale_is_the_median_ratio_of_the_longer_half() -> None:
    ratios = np.random.default_rng(2).uniform(0.5, 1.5, COUNT)
    moving = motions(metres=ratios, oriented=False)
    true = np.linalg.norm(moving.true_steps, axis=1)
    longer = true > np.median(true)
    found, spread = scale_of(moving)
    assert found == pytest.approx(np.median(ratios[longer]))
    logs = np.log(ratios[longer])
    assert spread == pytest.approx(np.diff(np.quantile(logs, [0.2, 0.8]))[0] / 2.0)
    still = motions(metres=0.0, oriented=False)
    assert scale_of(still) == (1.0, np.inf)


@pytest.mark.parametrize(
    ("metres", "gauge", "cause"),
    [
        (1.23, Gauge.YAW, "scale"),
        (1.21, Gauge.YAW, ""),
        (0.81, Gauge.YAW, "scale"),
        (0.825, Gauge.YAW, ""),
        (1.4, Gauge.SIM3, ""),
        (9_900.0, Gauge.YAW, "scale"),
        (10_100.0, Gauge.YAW, "diverged_at_start"),
    ],
)
def test_a_scale_is_beyond_a_fifth_of_its_logarithm(
    metres: float, gauge: Gauge, cause: str
) -> None:
    moving = motions(metres=metres, oriented=False)
    found = scale(as_read(moving), moving, gauge)
    assert found.scores["scale"] == pytest.approx(metres)
    assert found.scores["gain"] == pytest.approx(1.0)
    assert found.scores["spread"] == pytest.approx(0.0, abs=1e-9)
    assert [each.cause for each in found.seen] == [cause] * bool(cause)
    if cause == "scale":
        seen = only(found)
        assert seen.explained == found.scores["gain"]
        assert seen.values["scale"] == pytest.approx(metres)
        assert seen.values["gauge"] == "sim3"
    if cause == "diverged_at_start":
        values = only(found).values
        assert values["true_m"] == pytest.approx(metres * float(values["moved_m"]))
        assert values["moved_m"] == pytest.approx(COUNT * 1.5, rel=0.01)
    low = scale(as_read(moving, moving=0.8), moving, gauge)
    assert low.why_not == "displacements do not agree"


@pytest.mark.parametrize(
    ("metres", "size", "side", "unit", "factor"),
    [
        (1e-3 * 1.16, 300.0, "estimate", "millimetres", "0.001"),
        (1e-3 * 1.17, 300.0, "", "", ""),
        (1e-3, 1.0, "groundtruth", "kilometres", "1000"),
        (1e3 / 1.16, 1.0, "groundtruth", "millimetres", "0.001"),
        (1e3, 1e-3, "estimate", "kilometres", "1000"),
        (1e-2 * 1.10, 1.0, "estimate", "centimetres", "0.01"),
        (1e-2 * 1.11, 1.0, "", "", ""),
        (1e2, 1.0, "groundtruth", "centimetres", "0.01"),
        (0.0254 / 1.10, 1.0, "estimate", "inches", "0.0254"),
        (1.0 / 0.0254, 1.0, "groundtruth", "inches", "0.0254"),
        (0.3048 * 1.10, 1.0, "estimate", "feet", "0.3048"),
        (0.3048 * 1.11, 1.0, "", "", ""),
    ],
)
def test_units_are_known_by_their_length(
    metres: float, size: float, side: str, unit: str, factor: str
) -> None:
    """A body that moves by more than 200 m in a short motion is in millimetres."""
    moving = motions(metres=metres, oriented=False, size=size)
    seen = only(scale(as_read(moving), moving, Gauge.YAW))
    assert seen.cause == ("unit" if unit else "scale")
    assert (seen.values.get("side", ""), seen.values.get("unit", "")) == (side, unit)
    assert seen.values.get("factor", "") == factor
    # An alignment with scale shows only the unit of the groundtruth, if that is fast.
    shown = scale(as_read(moving), moving, Gauge.SIM3).seen
    fast = side == "groundtruth" and metres * size > 200.0
    assert [each.cause for each in shown] == ["unit"] * fast


@pytest.mark.parametrize(
    ("ratio", "is_told"), [(1.014, True), (1.016, False), (1 / 1.014, True), (1 / 1.016, False)]
)
def test_a_groundtruth_in_feet_may_be_a_monocular_estimate(ratio: float, *, is_told: bool) -> None:
    moving = motions(metres=ratio / 0.3048, oriented=False)
    seen = only(scale(as_read(moving), moving, Gauge.YAW))
    assert seen.cause == "scale"
    assert (seen.values["or_feet"] == ", or with groundtruth in feet") == is_told
    assert ("--scale 0.3048" in str(seen.values["or_convert"])) == is_told
    assert seen.values["gauge"] == ("" if is_told else "sim3")


@pytest.mark.parametrize(("spread", "is_told"), [(0.02, False), (0.05, True)])
def test_a_foot_is_within_the_spread_of_the_scale(spread: float, *, is_told: bool) -> None:
    """The scale is 4 % off."""
    ratios = np.exp(np.random.default_rng(3).normal(0.0, spread / 0.84, COUNT))
    moving = motions(metres=ratios, oriented=False)
    off = 1.04 / scale_of(moving)[0]
    moving = motions(metres=ratios * off / 0.3048, oriented=False)
    found = scale(as_read(moving, moving=0.9), moving, Gauge.YAW)
    assert found.scores["spread"] == pytest.approx(spread, rel=0.1)
    [told] = [each.values["or_feet"] for each in found.seen] or [""]
    assert bool(told) == is_told


@pytest.mark.parametrize(("apart", "is_seen"), [(0.33, True), (0.37, False)])
def test_a_scale_is_the_same_in_all_thirds(apart: float, *, is_seen: bool) -> None:
    """The last third has another one, by a part of the logarithm."""
    base = 2.0
    last = np.exp(np.log(base) * (1.0 + apart))
    metres = np.full(COUNT, base)
    metres[470:] = last
    moving = motions(world=TURN, metres=metres, oriented=False)
    found = scale(as_read(moving), moving, Gauge.YAW)
    true, own = moving.true_steps, TURN.apply(moving.steps)
    with_scale = np.sum((true - found.scores["scale"] * own) ** 2)
    gain = 1.0 - with_scale / np.sum((true - own) ** 2)
    assert found.scores["gain"] == pytest.approx(gain, rel=1e-4)
    logs = [np.log(scale_of(each)[0] / found.scores["scale"]) for each in moving.thirds]
    expected = max(map(abs, logs)) / abs(np.log(found.scores["scale"]))
    assert found.scores["thirds_apart"] == pytest.approx(expected)
    assert expected == pytest.approx(apart, rel=1e-6)
    assert bool(found.seen) == is_seen


def noisy_body(angle_deg: float, rest_deg: float) -> Rotation:
    """Return rotations of a body with pairs of opposite errors of an angle."""
    axes = np.random.default_rng(4).normal(size=(COUNT // 2, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    errors = Rotation.from_rotvec(np.radians(rest_deg) * np.concatenate([axes, -axes]))
    return Rotation.from_rotvec(np.radians(angle_deg) * np.array([0.6, 0.0, 0.8])) * errors


@pytest.mark.parametrize(
    ("angle_deg", "rest_deg", "is_seen"),
    [
        (5.1, 0.0, True),
        (4.9, 0.0, False),
        (8.0, 2.0, True),
        (30.0, 9.8, True),
        (30.0, 10.2, False),
    ],
)
def test_a_body_is_rotated_by_more_than_five_degrees_and_thrice_the_rest(
    angle_deg: float, rest_deg: float, *, is_seen: bool
) -> None:
    moving = motions(world=TURN, bodies=noisy_body(angle_deg, rest_deg))
    read = as_read(moving, turned=TURN.as_matrix(), cost=0.1, turning=0.9)
    found = body(read, moving)
    assert found.scores["angle_deg"] == pytest.approx(angle_deg, rel=1e-6)
    assert found.scores["rest_deg"] == pytest.approx(rest_deg, rel=1e-3, abs=1e-5)
    assert found.scores["rest_of_worlds_deg"] > 0.7 * angle_deg
    assert bool(found.seen) == is_seen
    if is_seen:
        seen = only(found)
        assert seen.explained == pytest.approx(1.0 - (rest_deg / angle_deg) ** 2, abs=1e-4)
        assert seen.values["angle_deg"] == found.scores["angle_deg"]
        assert seen.values["rest_deg"] == found.scores["rest_deg"]
    why_not = "motions do not agree"
    for changed in ({"turning": 0.8}, {"cost": 0.601}):
        assert body(Hypothesis(**{**vars(read), **changed}), moving).why_not == why_not
    assert not body(Hypothesis(**{**vars(read), "cost": 0.59}), moving).why_not
    assert body(read, motions(oriented=False)).why_not == "one side has no orientations"


@pytest.mark.parametrize(("angle_deg", "is_seen"), [(25.1, True), (24.9, False)])
def test_a_body_that_hardly_turns_may_be_a_world(angle_deg: float, *, is_seen: bool) -> None:
    """A rotation of the world fits as well."""
    small = 1e-3 * np.random.default_rng(3).normal(size=(2 * COUNT, 3))
    moving = motions(turned=Rotation.from_rotvec(small), bodies=noisy_body(angle_deg, 0.0))
    read = as_read(moving, turned=np.eye(3), cost=0.1, turning=0.9)
    found = body(read, moving)
    assert found.scores["rest_of_worlds_deg"] < 0.2
    # Without errors the rest is zero; here both rotations have some.
    errors = Rotation.from_rotvec(3e-3 * np.random.default_rng(6).normal(size=(COUNT, 3)))
    moving = motions(
        turned=Rotation.from_rotvec(small), bodies=noisy_body(angle_deg, 0.0) * errors
    )
    assert bool(body(read, moving).seen) == is_seen


@pytest.mark.parametrize(("apart", "is_seen"), [(0.34, True), (0.36, False)])
def test_a_body_is_rotated_alike_in_all_thirds(apart: float, *, is_seen: bool) -> None:
    angle = np.radians(40.0)
    angles = np.full(COUNT, angle)
    moving = motions(world=TURN)
    part = moving.thirds[2]
    last = COUNT - len(part)
    for _ in range(30):  # the mean angle changes with the last third
        mean = np.arctan2(np.sin(angles).sum(), np.cos(angles).sum())
        angles[last:] = mean * (1.0 + apart)
    bodies = Rotation.from_rotvec(np.outer(angles, [0.6, 0.0, 0.8]))
    moving = motions(world=TURN, bodies=bodies)
    found = body(as_read(moving, turned=TURN.as_matrix(), cost=0.1, turning=0.9), moving)
    assert found.scores["thirds_apart"] == pytest.approx(apart, abs=5e-3)
    assert bool(found.seen) == is_seen


@pytest.mark.parametrize(
    ("tilt_deg", "cost", "is_seen", "is_examined"),
    [
        (12.1, 0.29, True, True),
        (11.9, 0.29, False, True),
        (30.0, 0.31, False, True),
        (30.0, 0.59, False, True),
        (30.0, 0.61, False, False),
    ],
)
def test_worlds_are_tilted_by_more_than_twelve_degrees(
    tilt_deg: float, cost: float, *, is_seen: bool, is_examined: bool
) -> None:
    world = Rotation.from_euler("zx", [40.0, tilt_deg], degrees=True)
    moving = motions(world=world)
    read = as_read(moving)
    np.testing.assert_allclose(read.turned, world.as_matrix(), atol=1e-9)
    read = Hypothesis(**{**vars(read), "cost": cost})
    found = vertical(read, moving, moving, Gauge.YAW, UPS)
    assert bool(found.scores) == is_examined
    assert [each.cause for each in found.seen] == ["tilted"] * is_seen
    if is_examined:
        assert found.scores["tilt_deg"] == pytest.approx(tilt_deg)
    if is_seen:
        assert only(found).values == {"tilt_deg": found.scores["tilt_deg"]}
        assert found.scores["thirds_apart"] == pytest.approx(0.0, abs=1e-5)
    assert vertical(read, moving, moving, Gauge.SE3, UPS).why_not
    half = Hypothesis(**{**vars(read), "cost": cost / 2.0})
    without = moving.without_rotations()
    alone = vertical(half, without, without, Gauge.YAW, UPS)
    assert [each.cause for each in alone.seen] == [each.cause for each in found.seen]


@pytest.mark.parametrize(("off_deg", "is_axis"), [(4.9, True), (5.1, False)])
def test_a_vertical_axis_is_within_five_degrees(off_deg: float, *, is_axis: bool) -> None:
    """The estimate's y axis points down, as in a camera's frame."""
    world = Rotation.from_euler("x", -90.0 + off_deg, degrees=True)
    moving = motions(world=world)
    found = vertical(as_read(moving), moving, moving, Gauge.YAW, UPS)
    seen = only(found)
    assert seen.cause == ("up_axis" if is_axis else "tilted")
    if is_axis:
        assert seen.values["side"] == "estimate"
        assert seen.values["axis"] == "-y"
        assert seen.values["axes_up"] == "z,-y"
        assert seen.values["called"] == ", as in a camera's (x right, y down, z forward)"
        assert seen.values["off_deg"] == pytest.approx(off_deg)
        assert seen.values["tilt_deg"] == pytest.approx(90.0 - off_deg)
        assert [each.values["side"] for each in seen.rivals] == ["estimate", "groundtruth"]


def lever_found(
    lever: Floats, noise: float = 0.0, metres: float = 1.0, **changed: Any
) -> Examined:
    moving = motions(world=TURN, lever=lever, metres=metres)
    moving.groundtruth[1] += noise * np.random.default_rng(12).normal(size=(COUNT, 3))
    read = as_read(moving, turned=TURN.as_matrix(), **{"turning": 0.9, "cost": 0.1, **changed})
    return lever_arm(read, moving)


@pytest.mark.parametrize(("length", "is_seen"), [(0.0202, True), (0.0198, False), (0.2, True)])
def test_a_lever_arm_is_longer_than_two_centimetres(length: float, *, is_seen: bool) -> None:
    found = lever_found(length * np.array([0.48, 0.64, -0.6]))
    assert found.scores["lever_m"] == pytest.approx(length)
    assert found.scores["share"] == pytest.approx(1.0)
    assert bool(found.seen) == is_seen
    if is_seen:
        seen = only(found)
        assert seen.explained == found.scores["share"]
        assert seen.values["lever_m"] == pytest.approx(length)
        assert seen.values["percent"] == pytest.approx(100.0)
        assert found.scores["worst_third"] == pytest.approx(0.0, abs=1e-9)
        assert found.scores["apart"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("length", "noise", "is_seen"), [(0.053, 0.05, True), (0.047, 0.045, False)]
)
def test_a_lever_arm_that_explains_a_part_is_sure_from_five_centimetres(
    length: float, noise: float, *, is_seen: bool
) -> None:
    found = lever_found(length * np.array([0.48, 0.64, -0.6]), noise)
    assert 0.3 < found.scores["share"] < 0.7
    assert found.scores["lever_m"] == pytest.approx(length, abs=0.002)
    assert found.scores["apart"] < 0.35
    assert bool(found.seen) == is_seen


def test_lever_arms_need_motions_that_agree() -> None:
    lever = np.array([0.3, 0.0, 0.1])
    assert lever_found(lever, turning=0.8).why_not == "motions do not agree"
    assert lever_found(lever, cost=0.601).why_not == "motions do not agree"
    assert lever_found(lever, cost=0.59).seen
    assert lever_found(np.zeros(3), metres=1.05).why_not == "a scale explains the same error"
    scaled = lever_found(lever, metres=3.0)
    assert scaled.seen
    assert scaled.scores["lever_m"] == pytest.approx(np.linalg.norm(lever), rel=0.05)
