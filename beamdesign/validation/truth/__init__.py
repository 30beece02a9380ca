"""Truth model of the blind check: a rig of its own physics, which shares no equation with the diagnosis."""
