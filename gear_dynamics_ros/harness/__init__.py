"""Command profiles and expectations: what ``drive`` plays to a gearbox and checks on its outputs.

Free of ROS: a Player takes the waveform, chunk by chunk, and gives the commands that are due. Times of a
profile are simulated seconds since the harness joined the gearbox; values have the units of the commands and
channels.
"""
