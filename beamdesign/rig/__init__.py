"""Components of a rig and their assembly, in CasADi."""
