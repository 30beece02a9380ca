"""What may be behind a gap: nothing, effects of the library, plainly wrong figures, or some of these together.

A fit may move tolerated figures under the builder's priors, figures set free, and parameters of effects. Every unknown
is a number z whose prior is the standard normal distribution: a figure is its nominal value times exp(s z), with s its
tolerance; a parameter of an effect likewise about its default, or default + s z where it may be zero. So a z of 3 is
three standard deviations off, whatever its unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from math import exp, inf, isclose, log
from typing import Self

import numpy as np

from beamdesign.controllers import Controller, Proportional
from beamdesign.parameters import PARAMETERS, RIG_TOLERANCES, TORSION
from beamdesign.plant.assembly import Assembly, Structure, assemble, of_rig, parameters_of, sizes, suits
from beamdesign.plant.component import Law
from beamdesign.plant.effects import causes, laws_of, library
from beamdesign.prototype import Prototype
from beamdesign.structure.arm import off_axis
from beamdesign.structure.lumped import figures

FREE = 0.3
"""Prior standard deviation of the logarithm of a figure that is suspected to be plainly wrong."""

_ROUNDING = 1e-12


@dataclass(frozen=True)
class Unknown:
    """One number to be found.

    Attributes:
        name: of the figure, or `EFFECT.PARAMETER`.
        nominal: value at z = 0, SI.
        spread: of the logarithm, or of the value where `linear`.
        linear: whether the value is nominal + spread z.
        low: least value that makes sense.
        high: largest.
        kind: `figure` (tolerated), `free` (set free) or `effect`.
        tolerance: of a figure set free, the spread it would have were it not; 0 for others.
    """

    name: str
    nominal: float
    spread: float
    linear: bool
    low: float
    high: float
    kind: str
    tolerance: float = 0.0

    def value(self, z: float) -> float:
        """SI value at z.

        At a bound it is the bound: what a power gives there may lie an ulp beyond it, where no rig takes the figure.
        """
        value = self.nominal + self.spread * z if self.linear else self.nominal * exp(self.spread * z)
        for bound in (self.low, self.high):
            if isclose(value, bound, rel_tol=_ROUNDING):
                return bound
        return value

    def slope(self, z: float) -> float:
        """Derivative of the value by z."""
        return self.spread if self.linear else self.spread * self.value(z)

    def z(self, value: float) -> float:
        """The z of a value; without bound for none of what has a logarithm, as another law may have found it."""
        if self.linear:
            return (value - self.nominal) / self.spread
        return log(value / self.nominal) / self.spread if value > 0 else -inf

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest z."""
        low = self.z(self.low) if self.linear or self.low > 0 else -np.inf
        return low, self.z(self.high) if np.isfinite(self.high) else np.inf


def tolerated(prototype: Prototype, free: tuple[str, ...] = ()) -> tuple[Unknown, ...]:
    """The figures a builder vouches for only within a tolerance, and those set free.

    Args:
        prototype: with its `[tolerance]`.
        free: figures of the rig (as in `beamdesign.parameters.PARAMETERS`) suspected to be wrong.
    """
    nominal = parameters_of(prototype.but(controller=_some_law(prototype)), 0.0, 0.0)
    found = []
    for figure, key in RIG_TOLERANCES.items():
        spread = getattr(prototype.tolerance, key)
        if figure == "filter_frequency" and prototype.sensor.filter_Hz is None:
            continue
        if nominal.get(figure, 0.0) <= 0 or (figure in TORSION and nominal["payload_lever"] == 0):
            continue
        if figure in free:
            found.append(Unknown(figure, nominal[figure], FREE, False, 0.0, np.inf, "free", spread))
        elif spread > 0:
            found.append(Unknown(figure, nominal[figure], spread, False, 0.0, np.inf, "figure"))
    return tuple(found)


SUPPLY = "supply_pressure"
_SUPPLY_SPREAD = 0.6  # of the logarithm
AIR = "entrained_air"
"""Whose laws depend on the chambers' mean pressure, half the supply, which no tolerance vouches for."""


def known_effects(prototype: Prototype) -> tuple[str, ...]:
    """Effects that the prototype has already, sorted: they are at work under every hypothesis.

    Of a law to be learnt it may state the scales alone, by which a diagnosis looks for it.
    """

    def scaled(name: str, table: Mapping[str, float]) -> bool:
        scales = library()[name].scales
        return bool(scales) and set(scales) <= set(table) and not any(table[q] for q in table if q not in scales)

    return tuple(sorted(name for name, table in prototype.effects.items() if not scaled(name, table)))


def given(name: str, prototype: Prototype) -> Mapping[str, float]:
    """Parameters of an effect that no fit moves: of a learnt law, its scales and whatever else the prototype states."""
    return prototype.effects.get(name, {}) if library()[name].nearest else {}


def of_effects(names: tuple[str, ...], prototype: Prototype) -> tuple[Unknown, ...]:
    """The parameters of effects of the library, by their names, about what the prototype states of them, or the usual.

    Of learnt laws those are left out that are `given`.
    """
    supply = Unknown(SUPPLY, prototype.supply.pressure_Pa, _SUPPLY_SPREAD, False, 1e6, 60e6, "effect")
    stated = {f"{name}.{key}": value for name in names for key, value in prototype.effects.get(name, {}).items()}
    usual = of_rig(prototype) | stated
    size = sizes(prototype)
    own = (
        Unknown(place, float(usual.get(place, q.default)), q.spread, q.low <= 0, q.low, q.high, "effect")
        for name in names
        for place, q in ((f"{name}.{q.name}", q.of(size)) for q in library()[name].parameters)
        if q.name not in given(name, prototype)
    )
    return (*([supply] if set(names) & set(laws_of(AIR)) else []), *own)


def notes_on_known(prototype: Prototype) -> tuple[str, ...]:
    """What is said of effects that the prototype has already."""
    names = ", ".join(known_effects(prototype))
    return (f"The prototype states {names} already: named as a cause, it has other figures in the rig.",) * bool(names)


def left_as_known(prototype: Prototype, hypothesis: "Hypothesis") -> tuple[str, ...]:
    """Effects of the prototype that a hypothesis has no law for, and does not do without."""
    own = {cause(name.removeprefix(ABSENT)) for name in hypothesis.names}
    return tuple(name for name in known_effects(prototype) if cause(name) not in own)


@dataclass(frozen=True)
class Placement:
    """How unknowns enter the parameters of an assembly.

    Attributes:
        assembly: whose parameters.
        unknowns: in the order of z.
        rows: (P, K) 1 where the logarithm of a parameter goes with that of an unknown, or its value with a linear one.
    """

    assembly: Assembly
    unknowns: tuple[Unknown, ...]
    rows: np.ndarray

    @property
    def moved(self) -> tuple[int, ...]:
        """Indices of the parameters that some unknown moves."""
        return tuple(int(k) for k in np.nonzero(self.rows.any(axis=1))[0])

    def parameters(self, base: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(P,) parameters at z, from those of the believed rig."""
        p = base.copy()
        for k, unknown in enumerate(self.unknowns):
            value = unknown.value(z[k])
            for row, power in self._moved_by[k]:
                of_effect = unknown.kind == "effect"  # whose own default may be that of another size
                p[row] = value if of_effect else p[row] * (value / unknown.nominal) ** power
        return p

    @cached_property
    def _moved_by(self) -> list[list[tuple[int, float]]]:
        """Of each unknown the parameters that it moves, with their powers."""
        return [[(int(k), float(column[k])) for k in np.flatnonzero(column)] for column in self.rows.T]

    def slopes(self, p: np.ndarray) -> np.ndarray:
        """(P, K) derivative of the parameters by z, where they are p."""
        spread, linear = (np.array([getattr(u, name) for u in self.unknowns]) for name in ("spread", "linear"))
        return self.rows * np.where(linear, spread, spread * p[:, None])

    def under(self, law: Law | None) -> "Placement":
        """The same unknowns in the equations with another law, such as that of one record."""
        kinds = self.assembly.kinds
        return self if law == kinds.controller else place(replace(kinds, controller=law), self.unknowns)


@cache
def place(kinds: Structure, unknowns: tuple[Unknown, ...]) -> Placement:
    """Find the parameters of a structure that unknowns move."""
    assembly = assemble(kinds)
    index = {name: k for k, name in enumerate(assembly.parameters)}
    rows = np.zeros((len(index), len(unknowns)))
    for k, unknown in enumerate(unknowns):
        rows[index[unknown.name], k] = 1.0
        # The dashpot of a beam, b = 2 zeta sqrt(K M), goes with its stiffness and its mass; so does that of torsion.
        for part in ("outer", "inner", "torsional"):
            if unknown.name in (f"{part}_stiffness", f"{part}_mass"):
                rows[index[f"{part}_damping"], k] = 0.5
    return Placement(assembly, unknowns, rows)


def _some_law(prototype: Prototype) -> Controller:
    return prototype.controller.laws[0][0] if prototype.controller else Proportional(gain_A_per_V=1e-3)


def unlike(hypothesis: "Hypothesis", values: Mapping[str, float], prototype: Prototype) -> tuple[str, ...]:
    """Why effects with the SI values of a fit are rather something else that moves alike, in words.

    Of what the prototype states already nothing is said: its builder called it so.
    """
    figure, said = figures(prototype) | {name: v for name, v in values.items() if "." not in name}, []
    for name in hypothesis.effects:
        own = {key.removeprefix(f"{name}."): value for key, value in values.items() if key.startswith(f"{name}.")}
        if name not in prototype.effects and (words := library()[name].unlike(own, figure)):
            said.append(words)
    return tuple(said)


WRONG, ABSENT = "parameter:", "without:"
_SUBSYSTEM_OF = {row.tolerance: row.subsystem for row in PARAMETERS.values()} | {
    "line_loss": "oil", "edge_b": "servovalve", "piston_leakage": "actuator", "constant_load": "actuator"
}  # fmt: skip


@dataclass(frozen=True)
class Hypothesis:
    """What is held responsible.

    Attributes:
        names: sorted; of effects, `parameter:NAME` with the NAME of a `[tolerance]` whose figures are set free, and
            `without:NAME` of an effect that the prototype has and the rig has not. Of an effect a name may say in
            brackets the law that is meant: seal_friction (coulomb).
    """

    names: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Those that are effects of the library."""
        return tuple(name for name in self.names if not name.startswith((WRONG, ABSENT)))

    @property
    def figures(self) -> tuple[str, ...]:
        """Figures that are set free, of those that the rig has."""
        keys = [name.removeprefix(WRONG) for name in self.names if name.startswith(WRONG)]
        return tuple(figure for figure, key in RIG_TOLERANCES.items() if key in keys)

    @property
    def causes(self) -> tuple[str, ...]:
        """The names with those of laws replaced by the effects that they realise."""
        return tuple(sorted({cause(name) for name in self.names}))

    def without(self, named: str) -> "Hypothesis":
        """The rest, whichever law stands here for the cause named."""
        return Hypothesis(tuple(name for name in self.names if cause(name) != named))

    def realisation(self, named: str) -> str:
        """The name of the library, or of a figure, that stands here for a cause."""
        return next(name.partition(" (")[0] for name in self.names if cause(name) == named)

    def __str__(self) -> str:
        return " + ".join(self.causes) or "tolerances only"

    def __or__(self, other: "Hypothesis") -> Self:
        return type(self)(tuple(sorted({*self.names, *other.names})))

    def unknowns(self, prototype: Prototype) -> tuple[Unknown, ...]:
        """Everything a fit of it may move."""
        return tolerated(prototype, self.figures) + of_effects(self.effects, prototype)

    def placement(self, prototype: Prototype) -> Placement:
        """How its unknowns enter the equations, in which a law of the prototype's own acts: see `Placement.under`."""
        law, filtered = _some_law(prototype).equations, prototype.sensor.filter_Hz is not None
        effects = sorted({*self.effects, *left_as_known(prototype, self)})
        kinds = Structure(law, filtered, tuple(effects), prototype.rig, off_axis=off_axis(prototype))
        return place(kinds, self.unknowns(prototype))


NOTHING = Hypothesis()


def together(*names: str) -> Hypothesis:
    """Several causes at once."""
    return Hypothesis(tuple(sorted(set(names))))


def singles(prototype: Prototype) -> tuple[Hypothesis, ...]:
    """Every effect that can be at work in a rig, or be missing, and every figure that can be wrong, one at a time.

    A filter slower than believed is the effect `sensor_lag`, and no figure of its own.
    """
    effects = [Hypothesis((name,)) for name in causes() if suits(name, prototype)]
    keys = dict.fromkeys(RIG_TOLERANCES[u.name] for u in tolerated(prototype, tuple(RIG_TOLERANCES)))
    keys.pop("sensor_filter", None)
    lacking = (ABSENT + name for name in known_effects(prototype))
    return (*effects, *(Hypothesis((name,)) for name in (*lacking, *(WRONG + key for key in keys))))


def learnable(prototype: Prototype) -> tuple[Hypothesis, ...]:
    """Every law that data of a rig may teach, one at a time, but for those that its prototype has already."""
    known = known_effects(prototype)
    laws = (name for name, effect in library().items() if effect.nearest is not None and name not in known)
    return tuple(Hypothesis((name,)) for name in laws if suits(name, prototype))


def pairs(of: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """All pairs of different causes; an effect and its absence are none."""
    names = {h: {cause(name.removeprefix(ABSENT)) for name in h.names} for h in of}
    return tuple(a | b for a, b in combinations(of, 2) if not names[a] & names[b])


def cause(name: str) -> str:
    """What a diagnosis calls an effect of the library or a wrong figure: of several laws for one effect, the effect."""
    name = name.partition(" (")[0]
    effect = library().get(name)
    return effect.realises or name if effect is not None else name


def subsystem(name: str) -> str:
    """Where a cause sits."""
    if name.startswith(WRONG):
        return _SUBSYSTEM_OF[name.removeprefix(WRONG)]
    name = name.removeprefix(ABSENT)
    return next(effect.subsystem for effect in library().values() if name in (effect.name, effect.realises))
