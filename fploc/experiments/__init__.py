"""The stages of the reproduction, resumable."""
