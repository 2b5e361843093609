"""Targets as motions: poses and twists as functions of time."""
