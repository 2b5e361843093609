"""mcap"""
