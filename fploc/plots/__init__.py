"""Functions that return a Figure."""
