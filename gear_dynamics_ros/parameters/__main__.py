"""``python -m gear_dynamics_ros.parameters`` writes the table of parameters as a Markdown page."""

import sys

from gear_dynamics_ros.parameters import parameters_page

if __name__ == "__main__":
    sys.stdout.write(parameters_page())
