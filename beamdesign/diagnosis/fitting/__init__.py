"""Hypotheses about a gap, fitted to records, responses and critical gains."""
