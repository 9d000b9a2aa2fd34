"""Protocols, metrics, run log and reports."""
