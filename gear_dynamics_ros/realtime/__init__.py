"""Runs paced by the wall clock, without ROS."""
