"""Positions over time."""
