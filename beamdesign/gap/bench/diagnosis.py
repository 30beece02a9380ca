"""What a diagnosis of a bench says, as records."""

from dataclasses import dataclass, field

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.gap.bench.fit import HeldOut
from beamdesign.gap.bench.hypothesis import BenchHypothesis
from beamdesign.gap.bench.replay import ReplayError


@dataclass(frozen=True)
class Ranked:
    """One set of causes.

    Attributes:
        hypothesis: the causes.
        probability: among the candidates; see `diagnose_bench`.
        held_out: how it predicts conditions it has not seen.
    """

    hypothesis: BenchHypothesis
    probability: float
    held_out: HeldOut = field(repr=False)


@dataclass(frozen=True)
class Cause:
    """One cause, whatever others are at work beside it.

    Attributes:
        name: as contracts spell it.
        subsystem: where it sits.
        probability: sum over the candidates that have it.
        share: of the gap that comes back when it alone is taken out of the chosen set, at most 1; 0 where it is not in
            that set.
        parameters: value and standard deviation by contract name, where chosen.
    """

    name: str
    subsystem: str
    probability: float
    share: float
    parameters: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class ConditionRow:
    """What one condition says in one direction.

    Attributes:
        condition: name.
        direction: 1 extending, -1 retracting.
        command_V: while it moves.
        speed: m/s, mean of all runs.
        speed_std: m/s, of single runs.
        pressures: Pa, of chambers a and b.
        net_force_N: A_a p_a - A_b p_b with the areas of bore and rod: what friction and load take.
        opening: m3/s per root of Pa, flow over root of pressure drop of the edges (filling, emptying); they are alike
            where orifices and areas are the whole story.
        predicted: speed and both pressures by the chosen causes, fitted without this condition.
    """

    condition: str
    direction: int
    command_V: float
    speed: float
    speed_std: float
    pressures: tuple[float, float]
    net_force_N: float
    opening: tuple[float, float]
    predicted: tuple[float, float, float]


@dataclass(frozen=True)
class Gap:
    """Root mean square of relative speed errors and of pressure errors over the supply, on conditions held out.

    Attributes:
        before: of the prototype as it was believed.
        retuned: with the figures that have tolerances fitted.
        after: with the chosen causes.
        noise_floor: of means over replicates.
        closed: (before^2 - after^2)/(before^2 - floor^2).
        closed_interval: 5 and 95 % of a bootstrap over conditions, of which there are few.
    """

    before: float
    retuned: float
    after: float
    noise_floor: float
    closed: float
    closed_interval: tuple[float, float]


@dataclass(frozen=True)
class NextExperiment:
    """The command at which the candidates that are left differ most.

    Attributes:
        command_V: both directions.
        channel: in which they do.
        separation: standard deviation of the candidates' predictions over the deviation of that channel.
    """

    command_V: float
    channel: str
    separation: float


@dataclass(frozen=True)
class BenchDiagnosis:
    """What a bench's data set says.

    Attributes:
        verdict: `no_gap`, `effect`, `ambiguous` or `unknown`.
        reason: in two sentences.
        chosen: contract names of the causes held responsible: those more likely at work than not.
        causes: all of them, most probable first.
        ranked: sets of causes, most probable first.
        gap: on steady motions.
        table: by condition and direction.
        replay: errors of the simulated records, before and after, on conditions held out.
        confirmed: whether the replay is better with the chosen causes on every condition and in every channel.
        next_experiment: where the verdict is not certain.
        prototype: with the chosen causes, and the displacement's reading at the retracted stop and where it is clipped.
        notes: what cannot be told apart, what greedy selection would have done, flagged figures.
        warnings: oddities of the data.
    """

    verdict: str
    reason: str
    chosen: tuple[str, ...]
    causes: tuple[Cause, ...]
    ranked: tuple[Ranked, ...] = field(repr=False)
    gap: Gap
    table: tuple[ConditionRow, ...] = field(repr=False)
    replay: tuple[ReplayError, ...] = field(repr=False)
    confirmed: bool
    next_experiment: NextExperiment | None
    prototype: BenchPrototype = field(repr=False)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
