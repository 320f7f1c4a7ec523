"""Command profiles and expectations: what `drive` plays to a gearbox and what it checks on the outputs.

Nothing here knows ROS: a Player takes the waveform, chunk after chunk, and gives back the commands that are
due. Times of a profile are simulated seconds since the harness joined; units are those of the commands and
channels.
"""
