"""From a prototype to the structure and the figures of its rig."""

from beamdesign.plant.assembly import Structure
from beamdesign.plant.effects import library, problems
from beamdesign.plant.electronics import SAMPLED
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure import lumped


def structure_of(prototype: Prototype, sampled: bool = False) -> Structure:
    """What decides the equations of a prototype's rig.

    Args:
        prototype: with a controller, and with the effects its rig has.
        sampled: whether the controller is a sampled one, outside the equations.

    Raises:
        InputError: where an effect or one of its parameters is unknown or out of bounds, or without a controller.
    """
    wrong = list(problems(prototype.effects))
    if prototype.controller is None:
        wrong.append(problem_without_controller())
    if wrong:
        raise InputError(prototype.name, wrong)
    law = prototype.controller
    assert law is not None  # else there was a problem
    filtered, effects = prototype.sensor.filter_Hz is not None, tuple(sorted(prototype.effects))
    return Structure(SAMPLED if sampled else law.equations, filtered, effects)


def parameters_of(prototype: Prototype, outer_end_mass: float, inner_end_mass: float) -> dict[str, float]:
    """Parameters of the assembly in its order, SI: figures of the rig, of the controller and of its effects.

    Args:
        prototype: as for `structure_of`, which checks it.
        outer_end_mass: payload, kg.
        inner_end_mass: kg, added to the inner beam's tip.
    """
    controller = prototype.controller
    if controller is None:
        raise InputError(prototype.name, [problem_without_controller()])
    values = lumped.figures(prototype) | {
        "outer_end_mass": outer_end_mass,
        "inner_end_mass": inner_end_mass,
        "supply_pressure": prototype.supply.pressure_Pa,
        "believed_sensor_gain": prototype.sensor.gain_V_per_m,
        "gain": controller.gain_A_per_V,
        "pole": 1.0,
        "zero": 1.0,
    }
    values |= controller.figures()
    for name, table in effect_parameters_of(prototype).items():
        values |= {f"{name}.{key}": value for key, value in table.items()}
    return values


def effect_parameters_of(prototype: Prototype) -> dict[str, dict[str, float]]:
    """Parameters of a prototype's effects, sorted by name: as given, else the rig's own or the default."""
    # What an effect that is named alone takes from the rig itself.
    own = {"pressure_dependent_flow.supply_pressure_Pa": prototype.supply.pressure_Pa}
    return {
        name: {
            q.name: float(prototype.effects[name].get(q.name, own.get(f"{name}.{q.name}", q.default)))
            for q in library()[name].parameters
        }
        for name in sorted(prototype.effects)
    }


def problem_without_controller() -> Problem:
    """The problem of a prototype that cannot close its loop."""
    return Problem("controller", "missing; a simulation closes the loop")
