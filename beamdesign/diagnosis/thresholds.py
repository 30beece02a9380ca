"""The figures that decide a verdict, each with what it is calibrated by."""

from dataclasses import dataclass
from math import log


@dataclass(frozen=True)
class Thresholds:
    """What decides a verdict.

    Those of time records are held by the blind check of 200 sealed cases (`studies/gaps/blindcheck/result.md`), those
    of figures of the loop by the critical gains of the published rig (`tests/validation/test_paper_gap.py`), those of a
    bench by the measured cylinder (`tests/validation/test_measured_servo_cylinder.py`): who changes one repeats these.

    Attributes:
        effect_odds: logarithm of the prior odds of one more effect against none.
        figure_odds: of one more plainly wrong figure.
        law_odds: of another law for an effect than the usual one.
        not_explained: share of the excess misfit; a right cause, differently realised, leaves less.
        much: times the misfit of noise alone: what rigs leave that have a little of everything.
        steep: power by which shares go over into probabilities.
        nearly: in the logarithm of the probability: what is chosen among on held-out conditions.
        strained: tolerances by which no figure is off in a rig whose gap has been understood.
        explains: of the excess misfit, what an effect has to explain to be sure, where tolerances leave `a_gap`: of 16
            drawn sets whose effects were rightly sure, 15 left at most 0.11 of it and one 0.3.
        a_gap: times the misfit of noise.
        slight: of the misfit of noise alone.
        faint: of the mean square of the sensor's noise.
        minor: of the gap.
        all_but: times what is left of the displacement's error beyond noise.
        part: of what is left without a cause.
        plain: in cost, about three tolerances.
        as_much: of what a plainly wrong figure gains.
        confident: probability of the best hypothesis from which the verdict is not called ambiguous.
        worse: times the error of re-tuned tolerances: what held-out conditions speak against.
        near_noise: times the noise: what they never do.
        separate: difference in the logarithm of the probability from which figures of the loop are said to tell two
            hypotheses apart, 20 to 1.
        confident_by_gains: probability of causes, whatever else may be at work beside them, from which figures of the
            loop are said to name them.
        bench_odds: logarithm of the prior odds of one more cause on a bench.
        bench_sure: probability of a cause from which it is decided on a bench, and of none where it is below the rest.
        bench_likely: probability from which it is held responsible; and the least share of the gap that must close.
        bench_sound: times the floor: a gap of a bench smaller than this is not worth a cause.
        bench_lack: level of the test by which replicates say that a channel is not explained.
    """

    effect_odds: float = log(0.05)
    figure_odds: float = log(0.05)
    law_odds: float = log(0.33)
    not_explained: float = 0.15
    much: float = 2.5
    steep: float = 4.0
    nearly: float = 1.5
    strained: float = 4.0
    explains: float = 0.5
    a_gap: float = 1.3
    slight: float = 1.0
    faint: float = 0.75
    minor: float = 0.03
    all_but: float = 4.0
    part: float = 0.3
    plain: float = 8.0
    as_much: float = 0.8
    confident: float = 0.7
    worse: float = 1.1
    near_noise: float = 2.0
    separate: float = 3.0
    confident_by_gains: float = 0.8
    bench_odds: float = log(1 / 3)
    bench_sure: float = 0.9
    bench_likely: float = 0.5
    bench_sound: float = 3.0
    bench_lack: float = 0.01


THRESHOLDS = Thresholds()
