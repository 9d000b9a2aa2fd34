"""Lightning modules around the networks."""
