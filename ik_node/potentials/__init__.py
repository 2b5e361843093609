"""Potentials h(q) in joules and their gradients in N m (N): what moves the null space downhill."""
