"""ROS 2: messages in MCAP files and in the folders of rosbag2.

`topics` maps the samples of a part to messages, `stamps` gives them their times, and `mcap` writes them.
"""
