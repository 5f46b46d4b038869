"""Reading recordings: MCAP, rosbag2, ROS 1 bags and CARMEN logs as one stream of sweeps.

Other packages may add readers of further formats: see `logs.readers.Recording`.
"""

from specmap_cli.logs.opening import Log, open_log
from specmap_cli.logs.readers.recording import Message, TopicInfo

__all__ = ["Log", "Message", "TopicInfo", "open_log"]
