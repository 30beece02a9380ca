"""Diagnosis of the actuator on a bench."""
