"""From state and commands to chunks of samples: no clock, no ROS, no file."""
