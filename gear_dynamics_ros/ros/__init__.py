"""The node and the clients: all that needs rclpy."""
