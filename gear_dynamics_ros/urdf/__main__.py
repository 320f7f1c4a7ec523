"""``python -m gear_dynamics_ros.urdf``: see ``gear_dynamics_ros.cli.urdf``."""

import sys

from gear_dynamics_ros.cli.urdf import urdf_main

sys.exit(urdf_main())
