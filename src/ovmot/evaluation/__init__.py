"""Metrics: how far a run is from the truth."""
