"""``python -m gear_dynamics_ros.parameters``: the table of parameters as a Markdown page."""

import sys

from gear_dynamics_ros.parameters import reference

if __name__ == "__main__":
    sys.stdout.write(reference())
