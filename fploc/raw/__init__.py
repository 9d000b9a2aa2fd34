"""One parser per kind of public file."""
