"""What several tests need: small objects, servers, hostile files, stand-ins for ROS 2."""
