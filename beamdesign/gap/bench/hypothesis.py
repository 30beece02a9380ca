"""What may make a bench differ from what was believed of it."""

from dataclasses import dataclass, replace
from itertools import product

FRICTIONS = ("none", "viscous", "coulomb", "coulomb with offset", "stribeck")
_FRICTION_FIGURES = {
    "none": (),
    "viscous": ("viscous",),
    "coulomb": ("coulomb_N",),
    "coulomb with offset": ("coulomb_N", "constant_load_N"),
    "stribeck": ("coulomb_N", "breakaway_ratio", "stribeck_m_per_s"),
}


@dataclass(frozen=True)
class BenchHypothesis:
    """A set of causes.

    Attributes:
        orifices: flow goes with the root of the pressure drop.
        unequal_areas: the sides differ as bore and rod say.
        deadband: the valve opens only beyond a command.
        leakage: oil passes the piston.
        lines: lines to and from the valve lose pressure as oil flows.
        edge: the valve's edge from the supply to chamber b passes more or less than the others.
        friction: one of `FRICTIONS`.
        wrong_flow_gain: the flow gain is free of its tolerance.
    """

    orifices: bool = False
    unequal_areas: bool = False
    deadband: bool = False
    leakage: bool = False
    lines: bool = False
    edge: bool = False
    friction: str = "none"
    wrong_flow_gain: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Causes as contracts name them, sorted."""
        named = {
            "pressure_dependent_flow": self.orifices,
            "unequal_piston_areas": self.unequal_areas,
            "valve_deadband": self.deadband,
            "parameter:piston_leakage": self.leakage,
            "parameter:line_loss": self.lines,
            "parameter:edge_b": self.edge,
            "seal_friction": self.friction != "none",
            "parameter:constant_load": self.friction == "coulomb with offset",
            "parameter:flow_gain": self.wrong_flow_gain,
        }
        return tuple(sorted(name for name, there in named.items() if there))

    @property
    def causes(self) -> int:
        """How many causes, Stribeck's excess and the offset of friction counted as more than Coulomb's."""
        return len(self.names) + (self.friction == "stribeck")

    @property
    def figures(self) -> tuple[str, ...]:
        """Figures of the model that are fitted beside those with tolerances."""
        own = {
            "asymmetry": self.unequal_areas,
            "deadband_V": self.deadband,
            "piston_leakage": self.leakage,
            "line_loss": self.lines,
            "edge_b": self.edge,
        }
        return (*(name for name, there in own.items() if there), *_FRICTION_FIGURES[self.friction])

    def __str__(self) -> str:
        words = [name for name in self.names if name not in ("seal_friction", "parameter:constant_load")]
        if self.friction != "none":
            words.append(f"seal_friction ({self.friction})")
        return " + ".join(words) or "tolerances only"


def candidates(believed: BenchHypothesis | None = None) -> tuple[BenchHypothesis, ...]:
    """Every combination of causes, with those already believed; lines and edges show only where flow heeds pressure."""
    believed = believed or BenchHypothesis()
    yes = (False, True)
    found = [
        BenchHypothesis(orifices, areas, deadband, leakage, lines, edge, friction)
        for orifices, areas, deadband, leakage in product(yes, yes, yes, yes)
        for lines, edge in product(yes, yes)
        for friction in FRICTIONS
        if orifices or not (lines or edge)
    ]
    held = set(believed.figures) | set(believed.names)
    found = [each for each in found if held <= set(each.figures) | set(each.names)]
    return (*found, replace(believed, wrong_flow_gain=True))
