"""A scenario of a few steps, for what only has to be simulated at all."""

SCENARIO = """
name = "short"
duration_s = 0.02
[[record]]
name = "push"
outer_end_mass_kg = 2.0
input = [{ kind = "step", amplitude_N = 50.0, at_s = 0.002 }]
"""
