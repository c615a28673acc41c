"""ROS 2 messages without ROS: definitions, CDR packing, type hashes and rmw_zenoh keys."""
