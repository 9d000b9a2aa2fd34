"""The live server: phones send readings in, positions come out every tick."""
