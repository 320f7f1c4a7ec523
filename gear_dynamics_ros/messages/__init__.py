"""Chunks, commands and events as ROS 2 messages in CDR and back, without ROS."""
