"""Design: sections, controller and end mass, from what is asked."""

SIGMAS = 2.0
"""How many standard deviations of every figure at once a design is for, where nothing else is asked."""
