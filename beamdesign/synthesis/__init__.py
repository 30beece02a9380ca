"""Design: sections, controller and end mass, from what is asked."""

SIGMAS = 2.0
"""How many standard deviations of every figure at once a design is for, where nothing else is asked."""
TUBES = "outer_width_m=outer.width_m outer_wall_m=outer.wall_m inner_width_m=inner.width_m inner_wall_m=inner.wall_m"
SIZED = f"beam_mass_kg {TUBES}"
POINT = f"moving_mass_kg {SIZED}"
REMEDY = f"bandwidth_Hz peak_sensitivity added_mass_kg inner_end_mass_kg {TUBES}"
PROVED = "bandwidth_Hz peak_sensitivity inner_end_mass_kg gain_A_per_V=controller.gain_A_per_V"
"""Columns of a design in a table, each with where it stands in its record (see `beamdesign.result.picked`)."""
RIGS = 40
"""Drawn from the tolerances for a compliant law to suit, and others to count what it does on them."""
