"""Many runs at constant commands: a plan of points, their results, and the dataset made of them."""

from gear_dynamics_ros.sweeps.axis import Axis, parse_axis
from gear_dynamics_ros.sweeps.execution import run
from gear_dynamics_ros.sweeps.plan import SweepPlan
from gear_dynamics_ros.sweeps.point import Measurement, PointResult, measure

__all__ = ["Axis", "Measurement", "PointResult", "SweepPlan", "measure", "parse_axis", "run"]
