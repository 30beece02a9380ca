"""Diagnosis of the gap between a prototype and the rig that was built from it."""
