"""Motions from ROS 2: trajectory_msgs/JointTrajectory over rmw_zenoh keys, without ROS."""
