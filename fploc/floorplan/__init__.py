"""Georeferenced floor plans: pixels to metres, walls, crops between two points."""
