"""Decodes the messages that the mock of rclpy published, with rosbags."""

from rosbags.typesys import Stores, get_typestore

JAZZY = get_typestore(Stores.ROS2_JAZZY)


def decoded(publisher, kind):
    return [JAZZY.deserialize_cdr(data, kind) for data in publisher.sent]


def clouds(made):
    return decoded(made.publishers["points"], "sensor_msgs/msg/PointCloud2")


def statuses(made):
    return decoded(made.publishers["~/status"], "diagnostic_msgs/msg/DiagnosticStatus")


def values(status):
    return {pair.key: pair.value for pair in status.values}
