"""Protocol-free mending of the public files at build time."""
