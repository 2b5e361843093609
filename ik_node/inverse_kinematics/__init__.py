"""inverse_kinematics"""
