"""LightningDataModules: measured recordings and synthetic links."""
