"""A run in 3-D in the browser."""
