"""Truth model of the blind check: a rig of its own physics, which shares no equation with the diagnosis."""

from beamdesign.validation.truth.case import Case, Departure, Motion, Run, answer, noise_free, take, write_case
from beamdesign.validation.truth.drawing import KIND_NAMES, draw_case
from beamdesign.validation.truth.effects import LISTED, OUTSIDE, PARAMETERS

__all__ = [
    "KIND_NAMES",
    "LISTED",
    "OUTSIDE",
    "PARAMETERS",
    "Case",
    "Departure",
    "Motion",
    "Run",
    "answer",
    "draw_case",
    "noise_free",
    "take",
    "write_case",
]
