"""Proofs in rational arithmetic: stability and performance over a continuous range of masses, and their certificates."""
