"""Proofs in rational arithmetic: stability and performance over continuous ranges, and their certificates."""
