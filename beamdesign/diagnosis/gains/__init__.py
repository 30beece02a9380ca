"""Diagnosis from critical gains and frequency responses alone."""
