"""Virtual gearbox: a refined nonlinear gear-bearing model as a ROS 2 node and tools."""

__version__ = "0.1.0"
