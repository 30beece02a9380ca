"""Indicators of where a gap lies."""
