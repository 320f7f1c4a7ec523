"""Columns and codes of the contract with the rest of the package, as integers that numba freezes.

The only chapter that looks outside this folder.
"""

from __future__ import annotations

from gear_dynamics_ros.channels import CHANNELS, COLUMN, ENERGIES, IMPACTS
from gear_dynamics_ros.chunk import Status

RUNNING = int(Status.RUNNING)
OVER_SPEED = int(Status.OVER_SPEED)
NON_FINITE = int(Status.NON_FINITE)
CENTRES_PRESSED = int(Status.CENTRES_PRESSED)

CHANNEL_COUNT = len(CHANNELS)

TIME = COLUMN["time"]
DTE = COLUMN["dte"]
DTE_RATE = COLUMN["dte_rate"]
MESH_FORCE = COLUMN["mesh_force"]
PRESSURE_ANGLE = COLUMN["pressure_angle"]
POSITION_ANGLE = COLUMN["position_angle"]
HALF_BACKLASH = COLUMN["half_backlash"]
MESHING_STATE = COLUMN["meshing_state"]
# Of the driving gear and of the driven one.
CENTRE_X = (COLUMN["driving_x"], COLUMN["driven_x"])
CENTRE_Y = (COLUMN["driving_y"], COLUMN["driven_y"])
CONTACT_FORCE_X = (COLUMN["driving_contact_force_x"], COLUMN["driven_contact_force_x"])
CONTACT_FORCE_Y = (COLUMN["driving_contact_force_y"], COLUMN["driven_contact_force_y"])
FILM_FORCE_X = (COLUMN["driving_film_force_x"], COLUMN["driven_film_force_x"])
FILM_FORCE_Y = (COLUMN["driving_film_force_y"], COLUMN["driven_film_force_y"])
PENETRATION = (COLUMN["driving_penetration"], COLUMN["driven_penetration"])
SPEED = (COLUMN["driving_speed"], COLUMN["driven_speed"])
DRIVE_TORQUE = COLUMN["drive_torque"]
LOAD_TORQUE = COLUMN["load_torque"]
DRIVING_ANGLE = COLUMN["driving_angle"]
MESH_PHASE = COLUMN["mesh_phase"]

# Within a row of ENERGIES.
_ENERGY = {entry.name: i for i, entry in enumerate(ENERGIES)}
SHAFT_WORK = _ENERGY["shaft_work"]
EXCITATION_WORK = _ENERGY["excitation_work"]
MESH_LOSS = _ENERGY["mesh_loss"]
CONTACT_LOSS = (_ENERGY["driving_contact_loss"], _ENERGY["driven_contact_loss"])
FILM_WORK = (_ENERGY["driving_film_work"], _ENERGY["driven_film_work"])
KINETIC_ENERGY = _ENERGY["kinetic_energy"]
ELASTIC_ENERGY = _ENERGY["elastic_energy"]

# Within a row of IMPACTS.
_IMPACT = {entry.name: i for i, entry in enumerate(IMPACTS)}
IMPACT_SIZE = len(IMPACTS)
IMPACT_BEGIN = _IMPACT["begin"]
IMPACT_END = _IMPACT["end"]
IMPACT_BEARING = _IMPACT["bearing"]
IMPACT_SPEED = _IMPACT["impact_speed"]
REBOUND_SPEED = _IMPACT["rebound_speed"]
PEAK_FORCE = _IMPACT["peak_force"]

# What compiled code depends on beside the source of this folder.
FROZEN = repr((COLUMN, _ENERGY, _IMPACT, [(status.name, status.value) for status in Status]))
