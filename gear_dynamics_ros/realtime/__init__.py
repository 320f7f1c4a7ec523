"""A run at the pace of the wall clock: no ROS."""
