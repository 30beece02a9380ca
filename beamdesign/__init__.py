"""beamdesign."""
