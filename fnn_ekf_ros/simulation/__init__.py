"""The simulated robot: truth on exact arcs, and what its sensors make of it. No ROS, no files."""
