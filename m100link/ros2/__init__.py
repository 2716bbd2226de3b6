"""A node of ROS 2 without a ROS installation: what rmw_zenoh has on the wire, made here."""
