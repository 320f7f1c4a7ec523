"""Where the drawn gears, teeth, contacts and lines of action are, from samples. No Rerun.

The gears have their true size in mm. Gaps, DTE and displacements of the centres are ``scales.gap`` times as
large, and the teeth are narrowed to match: the distance of the drawn flanks along the drawn line of action
is the model's gap times ``scales.gap``, at every sample. The frame is that of docs/model.md, y upward. Points
are complex numbers x + iy in mm.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.involute import InvoluteGear, involute_function
from gear_dynamics_ros.viewer.scales import MILLIMETRES, DrawingScales

TEETH_IN_MESH: Final = 5  # of each gear, drawn with the exact gap
TURN: Final = 2.0 * math.pi

Points = NDArray[np.complex128]
Values = NDArray[np.float64]


class PairPose(NamedTuple):
    """The drawn pair at n samples; each field has shape (n,)."""

    driving_centre: Points
    driven_centre: Points
    driving_angle: Values  # rad, of a tooth of the driving gear: the channel's
    driven_angle: Values  # rad, counter-clockwise, of a tooth of the driven gear
    pressure_angle: Values  # rad, of the drawn pair
    position_angle: Values  # rad, of the drawn line of centres
    clearance: Values  # mm, half the backlash that the teeth are cut to
    flank: Values  # 1 where the drive flanks are shown as those in mesh, -1 the back flanks


class MeshContact(NamedTuple):
    """Flanks in mesh, or nearest to it, at n samples; each field has shape (n,)."""

    point: Points  # on the driving gear's flank, where the line of action cuts it
    direction: Points  # unit vector of the force on the driven gear for a mesh force > 0
    driving_tooth: Values  # rad, angle of the driving gear's tooth, as PairPose.driving_angle
    driven_tooth: Values  # rad
    gap: Values  # mm along the line of action from flank to flank; negative: overlap


def plane_vector(rows: Values, name: str) -> Points:
    """The channels ``name``_x and ``name``_y of samples (n, 28) as x + iy, shape (n,), in their unit."""
    return np.asarray(rows[:, COLUMN[f"{name}_x"]] + 1j * rows[:, COLUMN[f"{name}_y"]], dtype=np.complex128)


class GearPair:
    """The drawn gears of one set of parameters; lengths in mm."""

    def __init__(self, parameters: Parameters, scales: DrawingScales) -> None:
        gears = parameters.gears
        module = gears.module * MILLIMETRES
        self.driving = InvoluteGear(gears.driving.teeth, module, gears.pressure_angle)
        self.driven = InvoluteGear(gears.driven.teeth, module, gears.pressure_angle)
        self.scales = scales
        self.centre_distance = self.driving.reference_radius + self.driven.reference_radius
        self.nominal_clearance = 0.5 * gears.backlash * MILLIMETRES * scales.gap
        self._base_sum = self.driving.base_radius + self.driven.base_radius
        self._scale = MILLIMETRES * scales.gap

    def pose(self, rows: Values, revolutions: Values) -> PairPose:
        """The pair at samples ``rows`` (n, 28) after whole ``revolutions`` (n,) of the driving gear."""
        driving = self._scale * plane_vector(rows, "driving")
        driven = self.centre_distance + self._scale * plane_vector(rows, "driven")
        line = driven - driving
        alpha = np.arccos(np.minimum(self._base_sum / np.abs(line), 1.0))
        beta = np.angle(line)
        nominal = float(involute_function(self.driving.pressure_angle))
        widening = self._base_sum * (involute_function(alpha) - nominal)
        angle = rows[:, COLUMN["driving_angle"]]
        # The distance rolled ahead, of which q = u - R beta.
        ahead = self._scale * rows[:, COLUMN["dte"]] + self._base_sum * beta
        rolled = self.driving.base_radius * (angle + TURN * revolutions) - ahead
        return PairPose(
            driving_centre=driving,
            driven_centre=driven,
            driving_angle=angle,
            driven_angle=math.pi + 0.5 * self.driven.pitch_angle - rolled / self.driven.base_radius,
            pressure_angle=alpha,
            position_angle=beta,
            clearance=self._scale * rows[:, COLUMN["half_backlash"]] - widening,
            flank=np.where(rows[:, COLUMN["meshing_state"]] < 0.0, -1.0, 1.0),
        )

    def contact(self, pose: PairPose) -> MeshContact:
        """The flanks on the side ``pose.flank`` that are nearest to the pitch point."""
        side, alpha, beta = pose.flank, pose.pressure_angle, pose.position_angle
        base_pitch = self.driving.base_radius * self.driving.pitch_angle
        first = self._first_reach(self.driving, pose, pose.driving_angle - beta)
        second = self._first_reach(self.driven, pose, pose.driven_angle - beta - math.pi)
        teeth = np.round((self.driving.base_radius * np.tan(alpha) - first) / base_pitch)
        reach = first + teeth * base_pitch
        left = self._base_sum * np.tan(alpha) - reach
        facing = np.round((left - second) / base_pitch)
        tangent = np.exp(1j * (beta - side * alpha))
        return MeshContact(
            point=pose.driving_centre + (self.driving.base_radius + 1j * side * reach) * tangent,
            direction=1j * tangent,
            driving_tooth=pose.driving_angle + side * teeth * self.driving.pitch_angle,
            driven_tooth=pose.driven_angle + side * facing * self.driven.pitch_angle,
            gap=left - second - facing * base_pitch,
        )

    def line_of_action(self, pose: PairPose) -> Points:
        """Points of tangency with the base circles of driving and driven gear, shape (n, 2)."""
        tangent = np.exp(1j * (pose.position_angle - pose.flank * pose.pressure_angle))
        return np.stack(
            [
                pose.driving_centre + self.driving.base_radius * tangent,
                pose.driven_centre - self.driven.base_radius * tangent,
            ],
            axis=-1,
        )

    def teeth_in_mesh(self, pose: PairPose) -> tuple[Points, Points]:
        """Outlines of the TEETH_IN_MESH teeth of driving and driven gear nearest to the mesh, (n, points)."""
        towards = pose.position_angle
        return (
            self._teeth_towards(self.driving, pose, pose.driving_centre, pose.driving_angle, towards),
            self._teeth_towards(self.driven, pose, pose.driven_centre, pose.driven_angle, towards + math.pi),
        )

    def flanks_in_mesh(self, pose: PairPose, contact: MeshContact) -> tuple[Points, Points]:
        """The flanks of ``contact`` of driving and driven gear from root to tip, shape (n, FLANK_POINTS)."""
        return (
            self._flank(self.driving, pose, pose.driving_centre, contact.driving_tooth),
            self._flank(self.driven, pose, pose.driven_centre, contact.driven_tooth),
        )

    def _first_reach(self, gear: InvoluteGear, pose: PairPose, angle: Values) -> Values:
        """Length of the line of action from the base circle to the flank of the tooth at ``angle``.

        ``angle`` (rad) is that from the line of centres. The flanks of other teeth are base pitches away.
        """
        half = float(gear.half_angle(np.array(gear.base_radius))) - gear.narrowing_angle(pose.clearance)
        return np.asarray(gear.base_radius * (pose.pressure_angle + pose.flank * angle + half))

    def _teeth_towards(
        self, gear: InvoluteGear, pose: PairPose, centre: Points, angle: Values, towards: Values
    ) -> Points:
        nearest = np.round((towards - angle) / gear.pitch_angle)
        others = np.arange(TEETH_IN_MESH) - TEETH_IN_MESH // 2
        angles = angle[:, None] + (nearest[:, None] + others) * gear.pitch_angle
        tooth = gear.tooth(gear.narrowing_angle(pose.clearance))
        turned = np.exp(1j * angles)[:, :, None] * tooth[:, None, :]
        return np.asarray(centre[:, None] + turned.reshape(len(centre), -1))

    def _flank(self, gear: InvoluteGear, pose: PairPose, centre: Points, tooth: Values) -> Points:
        radii, half = gear.flank()
        angle = pose.flank[:, None] * (half - gear.narrowing_angle(pose.clearance)[:, None])
        return np.asarray(centre[:, None] + radii * np.exp(1j * (tooth[:, None] + angle)))
