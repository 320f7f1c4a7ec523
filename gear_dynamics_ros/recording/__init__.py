"""Recordings: rosbag2 folders of MCAP files, written, read, recovered, exported."""

from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.recording.reader import Recording, TopicCount, open

__all__ = ["OperatorEvent", "Recording", "TopicCount", "open"]
