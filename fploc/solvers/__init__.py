"""One-shot geometry: positions from ranges."""
