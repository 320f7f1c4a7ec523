"""Recordings: rosbag2 folders of MCAP files. Reading is here; ``recording.writer`` has the Recorder."""

from gear_dynamics_ros.recording.reader import Event, Recording, TopicCount, open

__all__ = ["Event", "Recording", "TopicCount", "open"]
