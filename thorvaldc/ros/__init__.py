"""The ROS 2 node of the base driver.

Only modules of this room import rclpy and ROS messages, and only when they are used: the list of
the parameters can be read without ROS.  The page docs/ros2-node.md describes the node.
"""
