"""Networks, apart from their training."""
