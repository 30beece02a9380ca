"""From a prototype to the structure and the figures of its rig."""

from math import pi

import numpy as np

from beamdesign import lumped
from beamdesign.observer import Observer
from beamdesign.prototype import Lag, Prototype, Structured
from beamdesign.records import InputError, Problem
from beamdesign.rig.assembly import Structure
from beamdesign.rig.effects import library, problems
from beamdesign.rig.electronics import observer_figures, section_figures


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
    if sampled:
        return Structure("sampled", filtered, effects)
    if isinstance(law, Observer):
        return Structure(law.kind, filtered, effects, order=law.order, sensors=_heard(law))
    sections = len(law.section) if isinstance(law, Structured) else 0
    return Structure(law.kind, filtered, effects, sections=sections)


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
        "pole": 2 * pi * controller.pole_Hz if isinstance(controller, Lag | Structured) else 1.0,
        "zero": 2 * pi * controller.zero_Hz if isinstance(controller, Lag | Structured) else 1.0,
    }
    if isinstance(controller, Structured):
        own = [
            figure
            for s in controller.section
            for figure in (2 * pi * s.zero_Hz, s.zero_damping_ratio, 2 * pi * s.pole_Hz, s.pole_damping_ratio)
        ]
        values |= dict(zip(section_figures(len(controller.section)), own, strict=True))
    if isinstance(controller, Observer):
        names = observer_figures(controller.order, _heard(controller))
        values |= dict(zip(names, _entries(controller), strict=True))
    for name, table in effect_parameters_of(prototype).items():
        values |= {f"{name}.{key}": value for key, value in table.items()}
    return values


def _heard(law: Observer) -> tuple[str, ...]:
    """What an observer is given: its sensors, and its command where that acts beside them."""
    return (*law.sensors, "command_V") if law.b_command else law.sensors


_TYPICAL = {"displacement_m": 0.1, "inner_displacement_m": 1e-4, "load_pressure_Pa": 1e6, "command_V": 0.1}
"""V, m, Pa: of what a controller is given."""
_POINTS_PER_S = (1 + 1j) * np.geomspace(1.0, 1e4, 25)
"""Off the imaginary axis, so that no undamped mode is met."""


def _entries(law: Observer) -> list[float]:
    """The matrices of an observer, in the order of `observer_figures`, for states that are of the order of one.

    Whoever designs it chooses the units of its states; a simulation wants to know when they stand still. They are
    scaled by powers of two, which round nothing.
    """
    heard = _heard(law)
    n, p = law.order, len(heard)
    a, b, c = np.reshape(law.a, (n, n)), np.reshape(law.b, (n, len(law.sensors))), np.array(law.c)
    if law.b_command:
        b = np.column_stack([b, law.b_command])
    if n:
        typical = b * [_TYPICAL[name] for name in heard]
        pencils = _POINTS_PER_S[:, None, None] * np.eye(n) - a
        size = np.abs(np.linalg.solve(pencils, np.broadcast_to(typical, (len(pencils), n, p)))).max(axis=(0, 2))
        scale = np.exp2(np.round(np.log2(np.where(size > 0, size, 1.0))))
        a, b, c = a * scale / scale[:, None], b / scale[:, None], c * scale
    d = (*law.d, 0.0) if law.b_command else law.d
    return [float(value) for part in (a, b, c, d) for value in np.ravel(part)]


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
