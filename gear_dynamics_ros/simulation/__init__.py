"""State and commands to chunks: no clock, no ROS, no file."""
