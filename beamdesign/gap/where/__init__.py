"""Witnesses of where a gap lies."""
