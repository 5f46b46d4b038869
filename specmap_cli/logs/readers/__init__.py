"""One reader a format of recordings, behind one protocol: files in, ROS 2 messages out."""
