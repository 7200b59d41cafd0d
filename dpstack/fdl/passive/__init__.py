"""Passive stations."""
