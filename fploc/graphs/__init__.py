"""Intervals as graphs of access points and devices."""
