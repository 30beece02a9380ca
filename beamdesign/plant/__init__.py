"""Components of a rig, its effects and their assembly, in CasADi, and the code generated from them."""
