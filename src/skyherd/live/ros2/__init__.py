"""ROS 2 over Zenoh, as `rmw_zenoh_cpp` writes it, without a ROS installation."""
