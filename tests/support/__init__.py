"""Code that several tests share: small objects, servers, hostile files, mocks of ROS 2."""
