"""Sweeps: a study or a prototype varied case by case, kept in a store, drawn and concluded."""
