"""ROS: the results of a run as messages, in bags and live."""
