"""Packed sites: downloading, building, verifying, reading."""
