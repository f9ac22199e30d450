"""The nodes; the only package that knows rclpy."""
