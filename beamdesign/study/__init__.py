"""Studies: a design problem carried through sizing, tuning and certification."""
