"""ROS at the edge: what a run says as messages, in bags and live."""
