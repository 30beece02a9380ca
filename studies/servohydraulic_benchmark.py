"""How many of its own standard deviations a servo-hydraulic benchmark survives, all figures off at once.

Usage, from the root of the project:

    python studies/servohydraulic_benchmark.py

The rig is that of the benchmark problem of C. E. Silva et al., "Benchmark control problem for real-time hybrid
simulation", Mechanical Systems and Signal Processing 135 (2020) 106381, doi 10.1016/j.ymssp.2019.106381: a servovalve
G_s = a1b0 / (s^2 + beta1 s + beta2), an actuator G_a = 1 / (s + a3) with the natural velocity feedback a2 s, and a mass
on a spring. Figures and standard deviations are those of a published implementation of it, not read off the paper.

The controller is this study's own, a proportional-integral one of the tracking error, g (1 + 1 / (T s)) with T = 1 s,
in the place of the benchmark's. Its gain alone is varied: what is lost on the way to the gain at which the nominal rig
oscillates, and which is the largest with a peak sensitivity of at most 2 of every rig within two standard deviations.
"""

from dataclasses import dataclass
from math import sqrt

from beamdesign import prove
from beamdesign.proofs.any_loop import ProvedLoop
from beamdesign.proofs.loop_family import loop_family
from beamdesign.proofs.tolerance_box import Scaling, largest_scaling

MASS_kg, STIFFNESS_N_per_m, DAMPING_RATIO = 29.13, 1190e3, 0.0097
A1B0, A2 = 2.1283e13, 4.2297e6
FIGURES = {"k": (STIFFNESS_N_per_m, 50e3), "a3": (3.3, 1.3), "beta1": (425.0, 3.3), "beta2": (99_976.0, 3300.0)}
"""Those that vary: what each is, and its standard deviation."""
PEAK, SIGMAS = 2.0, 2.0
GAINS = (4.8, 4.5, 3.0, 1.0)


@dataclass(frozen=True)
class Survival:
    """What is proved of one gain: of exactly the figures, and for how many standard deviations around them."""

    gain: float
    nominal: ProvedLoop
    scaling: Scaling


def ranges(sigmas: float) -> dict[str, tuple[float, float]]:
    """So many standard deviations to either side."""
    return {name: (middle - sigmas * sd, middle + sigmas * sd) for name, (middle, sd) in FIGURES.items()}


def loop(gain: float) -> tuple[str, str]:
    """Numerator and denominator of L over the figures that vary; the specimen's dashpot, mass, a1b0 and a2 are held."""
    dashpot = round(2 * DAMPING_RATIO * sqrt(STIFFNESS_N_per_m * MASS_kg), 2)
    specimen = f"({MASS_kg}*s**2 + {dashpot}*s + k)"
    return f"{gain}*{A1B0}*(s + 1)", f"s*(s**2 + beta1*s + beta2)*((s + a3)*{specimen} + {A2}*s)"


def survival(gain: float) -> Survival:
    """Around exactly the figures, up to where one that is positive would reach zero."""
    family = loop_family(loop(gain), ranges(1.0))
    nominal = prove(loop(gain), ranges(0.0)).middle
    return Survival(gain, nominal, largest_scaling(family.expression(), family.box))


def keeps(gain: float) -> bool:
    """Whether every rig within so many standard deviations is proved to keep the peak sensitivity."""
    return prove(loop(gain), ranges(SIGMAS), claims={"peak_sensitivity": PEAK}).yes


def tuned(low: float, high: float) -> float:
    """A gain that keeps it, next to one 0.01 above that does not: by halving, `low` being known to, `high` not to."""
    while high - low > 0.011:
        middle = round((low + high) / 2, 2)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low


def main() -> None:
    """Print a row for each gain."""
    print("  gain  first crossover  gain margin  peak sensitivity  standard deviations survived")
    for gain in (*GAINS, tuned(0.5, 3.0)):
        found = survival(gain)
        crossover = found.nominal.gain_crossings[0].frequency_rad_per_s[0]
        margin, peak = found.nominal.gain_increase[0], found.nominal.peak_sensitivity[1]
        print(f"{gain:6.2f} {crossover:10.1f} rad/s {margin:12.4f} {peak:17.4f}  {found.scaling.reason}")
    limit = FIGURES["a3"][0] / FIGURES["a3"][1]
    print(f"No factor is tried from {limit:.3f} on, where the leakage a3 would reach zero.")
    print(f"The last gain keeps a peak sensitivity of at most {PEAK:g} on every rig within {SIGMAS:g} of them.")


if __name__ == "__main__":
    main()
