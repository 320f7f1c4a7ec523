"""How large things are drawn: magnifications of micrometres and lengths of force arrows."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii

MILLIMETRES: Final = 1.0e3  # per m: the scene is drawn in mm
MICROMETRES: Final = 1.0e6  # per m
LARGEST_GAP: Final = 0.4  # modules: what the gaps between the teeth may take of them
HUB_SIZE: Final = 0.3  # reference radii: circle of the clearance in the hub of a gear
ARROW_LENGTH: Final = 0.35  # reference radii: arrow of the typical force
LONGEST_ARROW: Final = 0.75  # reference radii
STRUCK_SHARE: Final = 0.1  # of the force that presses the teeth as far as half the backlash
CLOSE_UP_SHARE: Final = 0.2  # length of the arrows in the close-up, of those in the scene
GREATEST_MAGNIFICATION: Final = 1.0e6


class DrawingScales(NamedTuple):
    """What the scene multiplies by, each 1, 2 or 5 times a power of ten, and its longest arrow."""

    gap: float  # backlash, DTE and displacement of the gears, so that drawn teeth touch when the model's do
    hub: float  # displacement of the journals in the hubs
    force: float  # mm of arrow per N
    longest_arrow: float  # mm; arrows of greater forces end there


def drawing_scales(parameters: Parameters) -> DrawingScales:
    """Scales at which the backlash, the clearances and the forces of ``parameters`` can be seen."""
    gears, bearings = parameters.gears, parameters.bearings
    clearance = bearings.driving.clearance + bearings.driven.clearance
    smaller = 0.5 * gears.module * min(gears.driving.teeth, gears.driven.teeth)
    largest = max(bearings.driving.clearance, bearings.driven.clearance)
    return DrawingScales(
        gap=round_down(LARGEST_GAP * gears.module / max(gears.backlash, clearance)),
        hub=round_down(HUB_SIZE * smaller / largest),
        force=round_down(ARROW_LENGTH * smaller * MILLIMETRES / typical_force(parameters)),
        longest_arrow=LONGEST_ARROW * smaller * MILLIMETRES,
    )


def typical_force(parameters: Parameters) -> float:
    """A mesh force in N that is often exceeded: static, of the greater torque, or of teeth that strike."""
    r1, r2 = base_radii(parameters)
    operation = parameters.operation
    struck = STRUCK_SHARE * parameters.mesh.stiffness * 0.5 * parameters.gears.backlash
    return max(abs(operation.drive_torque) / r1, abs(operation.load_torque) / r2, struck, 1.0)


def round_down(value: float) -> float:
    """The greatest of 1, 2, 5 times a power of ten that is at most ``value`` > 0."""
    bounded = min(value, GREATEST_MAGNIFICATION)
    power = 10.0 ** math.floor(math.log10(bounded))
    # A value such as 5 may come out as 4.999... of its power.
    return next(digit for digit in (5.0, 2.0, 1.0) if digit * power <= bounded * (1.0 + 1e-9)) * power
