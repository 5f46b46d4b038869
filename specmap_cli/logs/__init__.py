"""Reading recordings: MCAP, rosbag2, ROS 1 bags and CARMEN logs as one stream of sweeps."""

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Log, Message, TopicInfo

__all__ = ["Log", "Message", "TopicInfo", "open_log"]
