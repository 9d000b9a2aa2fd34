"""Layers that timm does not have."""
