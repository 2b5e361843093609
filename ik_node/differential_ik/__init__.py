"""differential_ik"""
