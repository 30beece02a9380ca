"""For a test that walks over all effects: of each a rig that has what it acts on."""

from honest_certificates import screw

from beamdesign import Prototype
from beamdesign.controllers import Observer
from beamdesign.plant.assembly import fits


def with_effects(rig: Prototype, *names: str) -> Prototype:
    """A rig with effects at their usual parameters; one with a screw where a cylinder lacks what they act on."""
    return having(rig, *names).but(effects={name: {} for name in names})


def having(rig: Prototype, *names: str) -> Prototype:
    """A rig with a cylinder, or the screw with its payload and tolerances where an effect acts on a screw alone.

    A law of added sensors goes with it and feels the screw's force, over the same area as the piston's.
    """
    if all(fits(name, rig.rig) for name in names):
        return rig
    own, law = screw().but(payload=rig.payload, tolerance=rig.tolerance), rig.controller
    if not isinstance(law, Observer):
        return own
    sensors = tuple("screw_force_N" if name == "load_pressure_Pa" else name for name in law.sensors)
    return own.but(controller=law.but(sensors=sensors))
