"""ROS 1's `ovmot_msgs` without a workspace: see `ovmot_msgs.msg`."""
