"""URDF of the gearbox for robot_state_publisher and ros2_control."""
