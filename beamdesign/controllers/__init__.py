"""Kinds of controller: what a command may ask of a law, and what it is refused with which reason."""

from beamdesign.controllers.cascade import Break, Cascade, Lag, Proportional, Section, Structured
from beamdesign.controllers.observer import Observer, wrong_sensors
from beamdesign.controllers.protocol import (
    KINDS,
    SENSED,
    SENSORS,
    Controller,
    Sensed,
    SensedLaw,
    TransferFunction,
    refuse,
    register,
)
from beamdesign.controllers.scheduled import Estimator, Scheduled, Stage

__all__ = [
    "KINDS", "SENSED", "SENSORS", "Break", "Cascade", "Controller", "Estimator", "Lag", "Observer", "Proportional",
    "Scheduled", "Section", "Sensed", "SensedLaw", "Stage", "Structured", "TransferFunction", "refuse", "register",
    "wrong_sensors",
]  # fmt: skip

for kind in (Proportional, Lag, Structured, Observer, Scheduled):
    register(kind)
