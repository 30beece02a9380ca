"""What may be behind a gap: nothing, effects of the library, plainly wrong figures, or some of these together."""

from dataclasses import dataclass
from itertools import combinations

from beamdesign.gap.fitting.unknowns import Placement, Unknown, of_effects, place, structure, tolerated
from beamdesign.parameters import PARAMETERS, RIG_TOLERANCES
from beamdesign.prototype import Prototype
from beamdesign.rig.effects import library

WRONG = "parameter:"
_SUBSYSTEM_OF = {row.tolerance: row.subsystem for row in PARAMETERS.values()}


@dataclass(frozen=True)
class Hypothesis:
    """What is held responsible.

    Attributes:
        names: sorted; of effects, and `parameter:NAME` with the NAME of a `[tolerance]` whose figures are set free.
    """

    names: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Those that are effects of the library."""
        return tuple(name for name in self.names if not name.startswith(WRONG))

    @property
    def figures(self) -> tuple[str, ...]:
        """Figures of the rig that are set free."""
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
        """The name that stands here for a cause."""
        return next(name for name in self.names if cause(name) == named)

    def __str__(self) -> str:
        return " + ".join(self.causes) or "tolerances only"

    def __or__(self, other: "Hypothesis") -> "Hypothesis":
        return together(*self.names, *other.names)

    def unknowns(self, prototype: Prototype) -> tuple[Unknown, ...]:
        """Everything a fit of it may move."""
        return tolerated(prototype, self.figures) + of_effects(self.effects, prototype)

    def placement(self, prototype: Prototype) -> Placement:
        """How its unknowns enter the equations."""
        return place(structure(prototype, self.effects), self.unknowns(prototype))


NOTHING = Hypothesis()


def together(*names: str) -> Hypothesis:
    """Several causes at once."""
    return Hypothesis(tuple(sorted(set(names))))


def singles(prototype: Prototype) -> tuple[Hypothesis, ...]:
    """Every effect that can be at work in a rig, and every figure that can be wrong, one at a time.

    A filter slower than believed is the effect `sensor_lag`, and no figure of its own.
    """
    effects = [Hypothesis((name,)) for name in library()]
    keys = dict.fromkeys(RIG_TOLERANCES[u.name] for u in tolerated(prototype, tuple(RIG_TOLERANCES)))
    keys.pop("sensor_filter", None)
    return (*effects, *(Hypothesis((WRONG + key,)) for key in keys))


def pairs(of: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """All pairs of different causes."""
    return tuple(a | b for a, b in combinations(of, 2) if not set(a.causes) & set(b.causes))


def cause(name: str) -> str:
    """What a diagnosis calls an effect of the library or a wrong figure: of several laws for one effect, the effect."""
    effect = library().get(name)
    return effect.realises or name if effect is not None else name


def subsystem(name: str) -> str:
    """Where a cause sits."""
    if name.startswith(WRONG):
        return _SUBSYSTEM_OF[name.removeprefix(WRONG)]
    return library()[name].subsystem
