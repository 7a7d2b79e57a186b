"""Placeholder being written."""
