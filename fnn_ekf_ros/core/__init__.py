"""The method: numpy only, pure functions, no ROS, files, clock, logging or global state."""
