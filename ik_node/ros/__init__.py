"""All that knows rclpy: nodes, parameters, spinning."""
