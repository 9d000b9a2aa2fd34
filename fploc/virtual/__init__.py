"""Virtual sites: a real plan filled by the generator."""
