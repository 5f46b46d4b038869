"""One reader a format of recordings, behind one protocol: files in, ROS 2 messages out.

`Recording` says what a reader must give; `logs.opening` holds the readers known.
"""

from specmap_cli.logs.readers.recording import Contents, Message, Recording, TopicInfo, survey

__all__ = ["Contents", "Message", "Recording", "TopicInfo", "survey"]
