"""The drawn pair against the samples: angles, and gaps measured on the drawn outlines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.viewer.gear_pair import TEETH_IN_MESH, GearPair, PairPose
from gear_dynamics_ros.viewer.scales import MILLIMETRES, drawing_scales, round_down

COUNT = 40
RATTLE = {"operation.speed": 1000.0, "operation.drive_torque": 1.0, "operation.load_torque": 1.0}
PAIRS = {
    "equal gears": Parameters.from_flat(RATTLE),
    "unequal gears": Parameters.from_flat(
        {**RATTLE, "gears.driving.teeth": 25, "gears.driven.teeth": 40, "gears.module": 0.004}
    ),
}


@pytest.fixture(scope="module", params=PAIRS)
def drawn(request: pytest.FixtureRequest) -> tuple[GearPair, NDArray[np.float64], PairPose]:
    """A pair, and samples in which each meshing state is."""
    parameters = PAIRS[request.param]
    engine = Engine(parameters)
    samples = np.concatenate([engine.advance().samples for _ in range(100)])
    state = samples[:, COLUMN["meshing_state"]]
    chosen = np.sort(np.concatenate([np.flatnonzero(state == flank)[-COUNT:] for flank in (-1.0, 0.0, 1.0)]))
    assert len(chosen) == 3 * COUNT
    wraps = np.cumsum(np.diff(samples[:, COLUMN["driving_angle"]], prepend=0.0) < -math.pi)
    pair = GearPair(parameters, drawing_scales(parameters))
    return pair, samples[chosen], pair.pose(samples[chosen], wraps[chosen].astype(float))


def chosen(pose: PairPose, which: list[int]) -> PairPose:
    return PairPose(*(field[which] for field in pose))


def refined_flanks(
    pair: GearPair, pose: PairPose, which: str, side: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Points on the flanks on one side of the drawn teeth in mesh, by the involute's closed form; (n, k)."""
    gear = getattr(pair, which)
    radii = np.linspace(gear.base_radius, gear.tip_radius, 1500)
    half = gear.half_angle(radii) - gear.narrowing_angle(pose.clearance)[:, None]
    towards = pose.position_angle + (math.pi if which == "driven" else 0.0)
    angle = getattr(pose, f"{which}_angle")
    nearest = angle + np.round((towards - angle) / gear.pitch_angle) * gear.pitch_angle
    teeth = (
        nearest[:, None, None]
        + gear.pitch_angle * np.arange(-2, 3)[:, None]
        + side[:, None, None] * half[:, None, :]
    )
    centre = getattr(pose, f"{which}_centre")
    return np.asarray(centre[:, None] + (radii * np.exp(1j * teeth)).reshape(len(pose.flank), -1))


def test_driving_teeth_stand_where_the_channel_says(
    drawn: tuple[GearPair, NDArray[np.float64], PairPose],
) -> None:
    pair, rows, pose = drawn
    teeth, _ = pair.teeth_in_mesh(pose)
    ends = teeth.reshape(len(rows), TEETH_IN_MESH, -1)[:, :, [0, -1]]
    middle = ends.mean(axis=2) - pose.driving_centre[:, None]
    from_channel = (np.angle(middle) - rows[:, [COLUMN["driving_angle"]]]) / pair.driving.pitch_angle
    np.testing.assert_allclose(from_channel, np.round(from_channel), atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_drawn_flanks_are_apart_by_the_models_gap(
    drawn: tuple[GearPair, NDArray[np.float64], PairPose], side: float
) -> None:
    """The least distance of the drawn flanks is the model's gap, and they overlap where it is negative."""
    pair, rows, pose = drawn
    gap = (rows[:, COLUMN["half_backlash"]] - side * rows[:, COLUMN["dte"]]) * MILLIMETRES * pair.scales.gap
    on_side = pose._replace(flank=np.full(len(rows), side))
    contact = pair.contact(on_side)
    np.testing.assert_allclose(contact.gap, gap, rtol=1e-9, atol=1e-9)
    apart = np.flatnonzero(gap > 0.01)[::10][:4].tolist()
    assert len(apart) == 4
    some = chosen(on_side, apart)
    mine = refined_flanks(pair, some, "driving", some.flank)
    others = refined_flanks(pair, some, "driven", some.flank)
    for i, point, expected in zip(range(len(apart)), contact.point[apart], gap[apart], strict=True):
        near, facing = (points[i][np.abs(points[i] - point) < 4.0] for points in (mine, others))
        # The points of a flank are some micrometres apart.
        assert np.abs(near[:, None] - facing).min() == pytest.approx(expected, abs=4e-3)


def test_contact_lies_on_both_drawn_flanks_and_the_line_of_action(
    drawn: tuple[GearPair, NDArray[np.float64], PairPose],
) -> None:
    pair, _, pose = drawn
    contact = pair.contact(pose)
    begin, end = pair.line_of_action(pose).T
    along = (end - begin) / np.abs(end - begin)
    np.testing.assert_allclose(((contact.point - begin) / along).imag, 0.0, atol=1e-9)
    np.testing.assert_allclose(contact.direction * pose.flank, along, atol=1e-12)
    for centre, base in (("driving", begin), ("driven", end)):
        middle = getattr(pose, f"{centre}_centre")
        radius = getattr(pair, centre).base_radius
        np.testing.assert_allclose(np.abs(base - middle), radius, rtol=1e-12)
    for which, point in (
        ("driving", contact.point),
        ("driven", contact.point + contact.gap * contact.direction * pose.flank),
    ):
        some = list(range(0, len(pose.flank), 10))
        flanks = refined_flanks(pair, chosen(pose, some), which, pose.flank[some])
        # The points of a flank are some micrometres apart.
        assert np.abs(flanks - point[some, None]).min(axis=1).max() < 8e-3


def test_turning_direction_and_pitch_point() -> None:
    """Gear 1 turns counter-clockwise, gear 2 clockwise, and the drive flank pushes gear 2 up and away."""
    parameters = Parameters()
    pair = GearPair(parameters, drawing_scales(parameters))
    rows = np.zeros((2, len(COLUMN)))
    rows[:, COLUMN["half_backlash"]] = 25.0e-6
    rows[:, COLUMN["meshing_state"]] = 1.0
    rows[1, COLUMN["driving_angle"]] = 0.01
    pose = pair.pose(rows, np.zeros(2))
    assert pose.driven_angle[1] - pose.driven_angle[0] == pytest.approx(-0.01)
    contact = pair.contact(pose)
    assert contact.direction[0].imag > 0.9
    assert contact.direction[0].real == pytest.approx(math.sin(parameters.gears.pressure_angle))
    middle = pair.line_of_action(pose)[0].mean()
    assert middle == pytest.approx(60.0)  # mm, half the centre distance


def test_scales_are_round_and_leave_the_teeth_whole() -> None:
    assert drawing_scales(Parameters()) == (20.0, 500.0, pytest.approx(0.02), pytest.approx(45.0))
    assert [round_down(value) for value in (1.0, 1.99, 2.0, 4.9, 5.0, 9.0, 10.0)] == [1, 1, 2, 2, 5, 5, 10]
    for backlash in (1e-9, 1e-4, 1e-3):
        scales = drawing_scales(Parameters.from_flat({"gears.backlash": backlash}))
        assert backlash * scales.gap <= 0.4 * Parameters().gears.module
