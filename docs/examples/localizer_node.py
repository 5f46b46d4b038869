"""Tells the room of a robot in ROS 2: `python localizer_node.py MAP`, with specmap installed."""

import sys

import numpy as np
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from specmap_cli import Localizer, Scan, SpecmapError

localizer = Localizer(sys.argv[1])


def heard(message: LaserScan) -> None:
    """Feed the localizer. Odometry from TF, as `odometry=(x, y, theta)`, helps it much.

    A laser that is not in the middle of the robot is told by `laser=(x, y, theta)`: else the pose
    that is printed is that of the laser.
    """
    stamp, angles = message.header.stamp, np.arange(len(message.ranges))
    scan = Scan(
        stamp_ns=stamp.sec * 10**9 + stamp.nanosec,
        ranges=message.ranges,
        angles=message.angle_min + message.angle_increment * angles,
        range_min=message.range_min,
        range_max=message.range_max,
        beam_s=message.time_increment,
    )
    try:
        found = localizer.add(scan)
    except SpecmapError as error:
        node.get_logger().warning(str(error))
    else:
        print(found.room, found.map_from_base)


rclpy.init()
node = rclpy.create_node("room")
node.create_subscription(LaserScan, "scan", heard, qos_profile_sensor_data)
rclpy.spin(node)
