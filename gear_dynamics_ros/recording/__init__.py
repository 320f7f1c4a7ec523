"""Recordings: rosbag2 folders of MCAP files. Reading is here; ``recording.recorder`` has the Recorder."""

from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.recording.reader import Recording, TopicCount, open

__all__ = ["OperatorEvent", "Recording", "TopicCount", "open"]
