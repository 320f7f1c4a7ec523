"""The node and its clients: the only modules that import rclpy."""
