"""Steady motions of a bench as evidence: causes that show in them, fitted, and how they predict what was left out."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from math import hypot

import numpy as np
from scipy.stats import f as f_ratio
from scipy.stats import t as student_t

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.fitting.fit import Fit, Fitted, fit
from beamdesign.diagnosis.fitting.hypothesis import WRONG, Hypothesis, Placement, Unknown, place, together
from beamdesign.diagnosis.fitting.steady_motion import CHANNELS, EDGES, Observations, averaged, stalled, steady
from beamdesign.plant.assembly import sizes
from beamdesign.plant.bench_simulation import bench_parameters, bench_structure
from beamdesign.plant.effects import library

ORIFICES, AREAS, DEADBAND = "pressure_dependent_flow", "unequal_piston_areas", "valve_deadband"
FRICTION, FLOW_GAIN, LOAD = "seal_friction", WRONG + "flow_gain", WRONG + "constant_load"
STEADY_EFFECTS = (ORIFICES, AREAS, DEADBAND, FRICTION)
"""Effects that have a part in steady motion."""
FRICTIONS = {
    f"{FRICTION} ({law})": tuple(f"{FRICTION}.{name}" for name in moved.split())
    for law, moved in (
        ("viscous", "viscous_N_s_per_m"),
        ("coulomb", "coulomb_N"),
        ("stribeck", "coulomb_N breakaway_ratio stribeck_m_per_s"),
    )
}
"""Laws of friction, each with the parameters that it moves."""
_OF_ORIFICES = (WRONG + "line_loss", WRONG + "edge_b")
_OTHERS = (ORIFICES, AREAS, DEADBAND, WRONG + "piston_leakage", *_OF_ORIFICES)
_MOVED = FRICTIONS | {
    ORIFICES: (),
    FLOW_GAIN: (),
    AREAS: (f"{AREAS}.asymmetry",),
    DEADBAND: (f"{DEADBAND}.half_width_A",),
    **{WRONG + name: (name,) for name in ("piston_leakage", "line_loss", "edge_b", "constant_load")},
}
_NONE = {FRICTION: {"coulomb_N": 0.0}}  # where a default of the library is not what there is without a cause


def moved(hypothesis: Hypothesis) -> tuple[str, ...]:
    """Parameters of a bench that are fitted beside those which are moved always."""
    return tuple(name for cause in hypothesis.names for name in _MOVED[cause])


def size(hypothesis: Hypothesis) -> int:
    """How many causes, Stribeck's excess of friction counted as one more."""
    return len(hypothesis.causes) + (f"{FRICTION}.breakaway_ratio" in moved(hypothesis))


def candidates(known: Hypothesis | None = None) -> tuple[Hypothesis, ...]:
    """Every combination of causes, with those already believed; lines and edges show only where flow heeds pressure."""
    known = known or together()
    held = {*moved(known), *known.causes}
    frictions = [(), *((law,) for law in FRICTIONS), (f"{FRICTION} (coulomb)", LOAD)]
    some = (one for count in range(len(_OTHERS) + 1) for one in combinations(_OTHERS, count))
    seen = (one for one in some if ORIFICES in one or not {*_OF_ORIFICES} & {*one})
    found = (together(*one, *friction) for one, friction in product(seen, frictions))
    return (*(each for each in found if held <= {*moved(each), *each.causes}), known | together(FLOW_GAIN))


def nominal_causes(prototype: BenchPrototype) -> Hypothesis:
    """Causes that a prototype already holds."""
    effects, at = prototype.effects, bench_parameters(prototype)
    found = [name for name in (ORIFICES, AREAS, DEADBAND) if name in effects]
    there = {"piston_leakage": at["piston_leakage"] > 0}
    if ORIFICES in effects:
        there |= {"line_loss": at["line_loss"] > 0, "edge_b": at["edge_b"] != 1}
    found += [WRONG + name for name, held in there.items() if held]
    if FRICTION in effects:
        load, stribeck = at["constant_load"] != 0, at[f"{FRICTION}.breakaway_ratio"] > 1
        law = "viscous" if at[f"{FRICTION}.coulomb_N"] == 0 else "stribeck" if stribeck and not load else "coulomb"
        found += [f"{FRICTION} ({law})", *([LOAD] if load and law == "coulomb" else [])]
    return together(*found)


def figures(prototype: BenchPrototype, hypothesis: Hypothesis) -> dict[str, float]:
    """Parameters of a bench as believed, with the effects of a hypothesis as stated, or with no part yet."""
    return bench_parameters(_with_effects(prototype, hypothesis))


def _with_effects(prototype: BenchPrototype, hypothesis: Hypothesis) -> BenchPrototype:
    names = [name for name in hypothesis.causes if name in library()]
    return prototype.but(effects={name: prototype.effects.get(name, _NONE.get(name, {})) for name in names})


_DROP_STD = 0.2
"""Standard deviation of the logarithm of flow that comes with orifices which the prototype does not state: a gain that
was believed of a linear valve belongs to no pressure drop, and half as much again of that is a fifth more flow."""
_WIDE = 1.0  # standard deviation of the logarithm of a figure that is free of its tolerance
_AREA_RATIO_STD = 0.02  # of the asymmetry that bore and rod give
_TANK_STD = 0.03  # of the supply: nothing is believed of the tank, and gauges are off by as much
_LEAST_TOLERANCE = 1e-4
_LOAD_STD_N = 20.0  # of a bench of size 1
_EDGE_STD = 0.1
_LOST = 0.1  # share of pressure lost in a line, or of flow past the piston, at the largest flow: one deviation


def steady_placement(prototype: BenchPrototype, hypothesis: Hypothesis, largest_V: float) -> Placement:
    """Everything a fit may move: within tolerances of a prototype, then under the priors of the library's effects.

    Args:
        prototype: what was believed.
        hypothesis: of what is at work.
        largest_V: command from which the largest flow follows.
    """
    known, at, tolerance = moved(nominal_causes(prototype)), figures(prototype, hypothesis), prototype.tolerance
    supply, largest_A = at["supply_pressure"], at["gain"] * largest_V
    flow = at["flow_gain"] * largest_A
    size = sizes(prototype)
    load, around = at["constant_load"], _LOAD_STD_N * size["force"]
    lost, loss = _LOST * flow / supply, _LOST * supply / flow**2
    orifices = ORIFICES in hypothesis.names
    new = orifices and ORIFICES not in prototype.effects
    vouched = _WIDE if FLOW_GAIN in hypothesis.names else hypot(tolerance.flow_gain, _DROP_STD if new else 0.0)
    fed = f"{ORIFICES}.supply_pressure_Pa" if orifices else "supply_pressure"
    spreads = {"flow_gain": vouched, "piston_area": tolerance.piston_area, fed: tolerance.supply_pressure}
    priors = {  # value without the cause, standard deviation, bounds
        "tank_pressure": (at["tank_pressure"], _TANK_STD * supply, 0.0, supply / 2),
        "piston_leakage": (0.0, lost, 0.0, 5 * lost),
        "line_loss": (0.0, loss, 0.0, 5 * loss),
        "edge_b": (1.0, _EDGE_STD, 0.5, 1.5),
        "constant_load": (load, around, load - 10 * around, load + 10 * around),
    }
    for name in STEADY_EFFECTS:
        own = [q.of(size) for q in library()[name].parameters]
        priors |= {f"{name}.{q.name}": (q.default, q.spread, q.low, q.high) for q in own}
    priors[f"{AREAS}.asymmetry"] = (prototype.actuator.asymmetry, _AREA_RATIO_STD, -0.5, 0.5)
    _, spread, low, high = priors[f"{DEADBAND}.half_width_A"]
    priors[f"{DEADBAND}.half_width_A"] = (0.0, spread, low, min(high, 0.9 * largest_A))
    unknowns = [
        Unknown(name, at[name], max(spread, _LEAST_TOLERANCE), False, at[name] / 10, 10 * at[name], "figure")
        for name, spread in spreads.items()
    ]
    for name in ("tank_pressure", *moved(hypothesis)):
        none, spread, low, high = priors[name]
        linear = not name.endswith("stribeck_m_per_s")
        unknowns.append(Unknown(name, at[name] if name in known else none, spread, linear, low, high, "effect"))
    return place(bench_structure(_with_effects(prototype, hypothesis)), tuple(unknowns))


_STALL, _STALL_STD = "stall", 0.01  # of the supply: pressures at a stop, to gauges' errors
_DEGREES = 4.0  # of freedom of Student's distribution: the deviation comes from few conditions
_ROUNDS = 3
_FIRST_DEVIATION, _LEAST_DEVIATION = 0.03, 1e-6
_DIFFERENCE, _INSIDE = 1e-4, 0.05  # of a prior standard deviation


@dataclass(frozen=True)
class SteadyEvidence(Fitted):
    """Steady motions in units of misfit.

    Attributes:
        seen: the motions.
        base: (P,) parameters of the believed bench with the effects of a hypothesis.
        deviation: by channel, of what is left in units of `predicted`.
    """

    seen: Observations
    base: np.ndarray = field(repr=False)
    deviation: Mapping[str, float]

    def predicted(self, placement: Placement, z: np.ndarray) -> dict[str, np.ndarray]:
        """(n,) errors by channel: relative ones of speeds, of pressures over the supply, of the contrast `EDGES`.

        Of speeds there is one per run, of a pressure one per row that recorded it, of edges one per condition.
        """
        p = placement.parameters(self.base, z)
        return {channel: error[0] for channel, error in self._errors(placement, p[:, None]).items()}

    def beside(self, placement: Placement, z: np.ndarray, step: np.ndarray) -> dict[str, np.ndarray]:
        """(K + 1, n) the same, at z and a step (K,) beside it in each direction."""
        p = placement.parameters(self.base, z)
        return self._errors(placement, np.column_stack([p, p[:, None] + step * placement.slopes(p)]))

    def _errors(self, placement: Placement, columns: np.ndarray) -> dict[str, np.ndarray]:
        """(m, n) for m columns of parameters."""
        seen, rows = self.seen, self.seen.rows
        figure = dict(zip(placement.assembly.parameters, columns[:, :, None], strict=True))
        found = steady(figure, seen.volts)
        error = {"speed": (found["speed"] / rows.speed - 1)[..., seen.timed]}
        for side in "ab":
            there, channel = rows.side == side, f"pressure_{side}"
            error[channel] = (found[channel][..., there] - rows.pressure[there]) / seen.supply_Pa
        out, back = seen.both_ways
        speeds = found["speed"][..., out], -found["speed"][..., back]
        empty = found["pressure_b"][..., out], found["pressure_a"][..., back]
        error[EDGES] = seen.contrast(speeds, empty) - seen.contrasts
        held = np.where(seen.filled, *stalled(figure, seen.volts))
        return error | {_STALL: (held - rows.stall) / seen.supply_Pa}

    def of(self, condition: str) -> "SteadyEvidence":
        """Those of one condition."""
        return replace(self, seen=self.seen.of([condition]))

    def misfit(self, predicted: Mapping[str, np.ndarray]) -> np.ndarray:
        """(..., M) errors, weighed."""
        return np.concatenate([predicted[c] / self.deviation[c] for c in (*CHANNELS, EDGES, _STALL)], axis=-1)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their slopes, by differences that stay within the bounds."""
        high = np.array([u.bounds[1] for u in placement.unknowns])
        step = np.where(z + _DIFFERENCE > high, -_DIFFERENCE, _DIFFERENCE)
        found = self.misfit(self.beside(placement, z, step))
        return found[0], ((found[1:] - found[0]) / step[:, None]).T


def moving(prototype: BenchPrototype, found: Fit, volts: np.ndarray) -> dict[str, np.ndarray]:
    """Steady motion at commands (N,) from the null, as a fit has it; see `steady`."""
    return steady(figures(prototype, found.hypothesis) | found.values, volts)


def fit_steady(
    prototype: BenchPrototype,
    hypothesis: Hypothesis,
    seen: Observations,
    floor: Mapping[str, float],
    near: Mapping[str, float] | None = None,
) -> tuple[Fit, SteadyEvidence, Placement]:
    """Fit a hypothesis with everything tolerated under its prior; what it cannot explain widens its errors.

    Args:
        prototype: what was believed.
        hypothesis: the causes.
        seen: what it is fitted to.
        floor: least deviation by channel.
        near: figures to start from, those of the priors where not given.

    Returns:
        the fit, the motions as they were weighed in the end, and how the fit's unknowns enter the equations.
    """
    placement = steady_placement(prototype, hypothesis, float(np.abs(seen.volts).max()))
    first = {c: max(least, _FIRST_DEVIATION) for c, least in floor.items()} | {_STALL: _STALL_STD}
    piece = SteadyEvidence(seen, np.array(list(figures(prototype, hypothesis).values())), first)
    low, high = (np.array(side) for side in zip(*(u.bounds for u in placement.unknowns), strict=True))
    start = np.array([u.z(near[u.name]) if near else 0.0 for u in placement.unknowns])
    z = np.clip(start, low + _INSIDE, high - _INSIDE)
    for _ in range(_ROUNDS):
        z = fit(hypothesis, placement, [piece], z).z
        left = piece.predicted(placement, z)
        own = {c: max(least, np.sqrt(np.mean(left[c] ** 2)), _LEAST_DEVIATION) for c, least in floor.items()}
        piece = replace(piece, deviation={**piece.deviation, **own})
    return fit(hypothesis, placement, [piece], z, 0), piece, placement


@dataclass(frozen=True)
class HeldOut:
    """How a hypothesis predicts conditions that its fit has not seen.

    Attributes:
        hypothesis: the causes.
        fit: to all conditions.
        deviation: by channel, of what that fit leaves.
        error: by condition and channel, root of the mean square over both directions.
        density: by condition, logarithm of the predictive density of its mean speeds and pressures.
        without: by condition, the fit that has not seen it.
        lack: by channel, p of its lack of fit, see `lack_of_fit`.
    """

    hypothesis: Hypothesis
    fit: Fit
    deviation: Mapping[str, float]
    error: dict[str, dict[str, float]]
    density: dict[str, float]
    without: dict[str, Fit] = field(repr=False)
    lack: Mapping[str, float] = field(repr=False)

    @property
    def total(self) -> float:
        """Root of the mean square over conditions and channels."""
        return float(np.sqrt(np.mean([value**2 for each in self.error.values() for value in each.values()])))

    @property
    def left_out(self) -> Fit:
        """The fit with the mean square of what it misses on conditions left out as its misfit."""
        (share,) = self.fit.shares
        return replace(self.fit, shares=(replace(share, c=self.total**2),))


def nominal_evidence(
    prototype: BenchPrototype, known: Hypothesis, seen: Observations
) -> tuple[SteadyEvidence, Placement]:
    """Motions in units of their scatter, and a placement that moves nothing of the believed bench."""
    piece = SteadyEvidence(seen, np.array(list(figures(prototype, known).values())), seen.scatter)
    return piece, place(bench_structure(_with_effects(prototype, known)), ())


def held_out(prototype: BenchPrototype, hypothesis: Hypothesis, seen: Observations) -> HeldOut:
    """Fit a hypothesis once to everything and once without each condition."""
    error, density, without = {}, {}, {}
    everything, whole, placement = fit_steady(prototype, hypothesis, seen, seen.scatter)
    for condition in seen.conditions:
        others = seen.of([c for c in seen.conditions if c != condition])
        trained, weighed, there = fit_steady(prototype, hypothesis, others, seen.scatter, everything.values)
        own = whole.of(condition)
        found = own.beside(there, trained.z, np.full(len(trained.z), _DIFFERENCE))
        means = averaged(own.seen, found)
        error[condition] = {channel: float(np.sqrt(np.mean(means[channel][0] ** 2))) for channel in CHANNELS}
        density[condition] = _density(trained, weighed.deviation, means | {EDGES: found[EDGES]})
        without[condition] = trained
    lack = lack_of_fit(whole, placement, everything)
    return HeldOut(hypothesis, everything, whole.deviation, error, density, without, lack)


def lack_of_fit(piece: SteadyEvidence, placement: Placement, found: Fit) -> dict[str, float]:
    """Probability that replicates which scatter as they do are missed by a right model as far as by a fit, by channel.

    The test of lack of fit against pure error (N. R. Draper and H. Smith, Applied Regression Analysis, 3rd ed. 1998,
    section 2.1), with means of replicates as cells; the figures that were fitted take no degrees from it, so that it
    rejects too seldom. NaN where nothing was repeated.

    Args:
        piece: the motions.
        placement: of the fit's unknowns.
        found: the fit to them.
    """
    squares, cells, runs = dict.fromkeys(CHANNELS, 0.0), dict.fromkeys(CHANNELS, 0), dict.fromkeys(CHANNELS, 0)
    for condition in piece.seen.conditions:
        own = piece.of(condition)
        left = own.predicted(placement, found.z)
        for channel, means in averaged(own.seen, left).items():
            count = len(left[channel])
            squares[channel] += float(np.sum(means**2)) * count / len(means)
            cells[channel] += len(means)
            runs[channel] += count
    freedom = {c: runs[c] - cells[c] for c in CHANNELS}
    ratio = {c: squares[c] / cells[c] / piece.seen.scatter[c] ** 2 for c in CHANNELS}
    return {c: float(f_ratio.sf(ratio[c], cells[c], freedom[c])) if freedom[c] > 0 else np.nan for c in CHANNELS}


def _density(trained: Fit, deviation: Mapping[str, float], missed: Mapping[str, np.ndarray]) -> float:
    """Logarithm of Student's density of what was missed, means over replicates; uncertain figures widen it.

    Args:
        trained: the fit.
        deviation: of it by channel.
        missed: by channel, (K + 1, n) at its z and `_DIFFERENCE` beside it in each direction.
    """
    total = 0.0
    for channel, means in missed.items():
        slopes = (means[1:] - means[0]).T / _DIFFERENCE
        spread = deviation[channel] ** 2 + np.sum(slopes @ trained.covariance * slopes, axis=1)
        total += float(np.sum(student_t.logpdf(means[0], _DEGREES, scale=np.sqrt(spread))))
    return total


_MADE_OF_NOTHING = 2.0  # times the force of the difference of two gauges: a load that may be no more than that


def gauge_doubts(prototype: BenchPrototype, found: Fit, seen: Observations) -> tuple[str, ...]:
    """What two gauges leave in doubt that differ against the stops, in words."""
    doubts, stated = list[str](), prototype.actuator.constant_load_N
    if differ := seen.gauges_differ_Pa:
        doubts.append(f"pressure_a_Pa reads {differ:.3g} Pa more than pressure_b_Pa at either stop: zero both gauges")
    apart, load = max(map(abs, seen.gauges_apart_Pa)), found.values.get("constant_load", stated) - stated
    if 0 < abs(load) < _MADE_OF_NOTHING * apart * prototype.actuator.piston_area_m2:
        words = f"a constant load of {load:.3g} N may be none: both gauges differ by {apart:.3g} Pa at a stop"
        doubts.append(f"{words}; exchange them, and measure again")
    return tuple(doubts)


_CLOSE = 0.8  # correlation from which two figures are told as one


def correlated(fit: Fit) -> list[str]:
    """Pairs of figures which the data determine together but not each, with their correlation."""
    deviation = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(deviation, deviation)
    names = list(fit.values)
    close = ((i, j) for i in range(len(names)) for j in range(i) if abs(correlation[i, j]) > _CLOSE)
    return [f"{names[i]} and {names[j]} (correlation {correlation[i, j]:+.2f})" for i, j in close]
