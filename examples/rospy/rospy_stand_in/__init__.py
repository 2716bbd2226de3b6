"""A stand-in for ROS 1: programs written for rospy run unmodified, without ROS, on rosbridge.

``rospy_stand_in.packages.run_program`` runs one. It finds ``rospy``,
``actionlib``, ``tf.transformations`` and the message packages here, and a station by rosbridge:
topics and services of the station are those of a program; all others stay inside it.
"""
