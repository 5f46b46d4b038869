"""Reading recordings: MCAP, rosbag2, ROS 1 bags and CARMEN logs as one stream of sweeps."""
