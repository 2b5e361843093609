"""Measurements in full counts, one module per part of ``ik_benchmark``; tests run samples of them."""
