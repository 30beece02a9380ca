"""Three questions about one prototype over a range of outer end masses: what is stable, is all of it, how good is it.

The proofs start from the prototype, the grids from matrices derived beforehand, so that only what each method does for
its answer is counted, and rather too much of the proofs.
"""

from itertools import pairwise

import numpy as np
from comparison import Comparison, Cost, Effort, Method, timed
from grids import Margins, closed_loops, growth, last_within, margins, matrices, models, responses, stable_stretches

from beamdesign import Prototype, certify
from beamdesign.loop import Loop, loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Certificate
from beamdesign.proofs.stability import is_stable_over

Stretches = list[tuple[float, float]]


class Rig:
    """A prototype on both grids of masses, with what its grid methods need."""

    def __init__(self, prototype: Prototype, high_kg: float, effort: Effort):
        assert prototype.controller is not None
        self.prototype, self.controller, self.high_kg = prototype, prototype.controller, high_kg
        self.matrices, self.inner_kg = matrices(paper_model(prototype)), prototype.payload.inner_end_mass_kg
        self.swept, self.dense = (np.linspace(0.0, high_kg, points) for points in (effort.sweep, effort.grid))
        margins(models(self.matrices, self.controller, self.inner_kg, self.swept[:2]))  # so that it is timed warm

    def certificate(self) -> Certificate:
        """Everything that is proved, and its text."""
        return certify(self.prototype, 0.0, self.high_kg)

    def margins(self) -> Margins:
        """The margin sweep."""
        return margins(models(self.matrices, self.controller, self.inner_kg, self.swept))

    def growth_at(self, masses_kg: np.ndarray) -> np.ndarray:
        """Largest real part of any eigenvalue, 1/s."""
        return growth(closed_loops(self.matrices, self.controller, self.inner_kg, masses_kg))

    def growth(self) -> np.ndarray:
        """The eigenvalue grid."""
        return self.growth_at(self.dense)

    def curves(self) -> tuple[np.ndarray, np.ndarray]:
        """Closed-loop responses of the sweep on its frequency grid."""
        return responses(models(self.matrices, self.controller, self.inner_kg, self.swept))

    @property
    def sweep_name(self) -> str:
        """What the table calls the margin sweep."""
        return f"python-control, margins at {len(self.swept)} masses"

    @property
    def grid_name(self) -> str:
        """What the table calls the eigenvalue grid."""
        return f"numpy, eigenvalues at {len(self.dense)} masses"


def compare_ranges(rig: Rig, effort: Effort, row: str, question: str) -> Comparison:
    """What is stable: ranges and crossings against what the grids read."""
    proof, certificate = timed(rig.certificate, effort.repeats)
    exact = certificate.stable_ranges_kg
    sweep, found = timed(rig.margins, effort.sweeps, warm=False)
    dense, fastest = timed(rig.growth, effort.repeats)
    crossings = [crossing.value for crossing in certificate.crossings]
    between = [(low + high) / 2 for (_, low), (high, _) in pairwise(exact)]
    grows = float(rig.growth_at(np.array(between)).max()) if between else 0.0
    inside = f"; between them the fastest root grows by {grows:.2g} 1/s" if between else ""
    methods = [
        Method(
            "proof: ranges, crossings, certificate", proof, f"stable {_words(exact)}{inside}", facts={"growth": grows}
        )
    ]
    for name, cost, masses, stable in (
        (rig.sweep_name, sweep, rig.swept, found.read_stable),
        (rig.grid_name, dense, rig.dense, fastest < 0),
    ):
        methods.append(_read(name, cost, masses, stable, exact, crossings))
    worst = disagreement(loop(rig.prototype), rig.swept, found)
    agreed = f"; the least gain margin it sees is {found.gain.min():.7g}" if found.read_stable.all() else ""
    agreed += f"; the margins themselves agree with the exact ones to {worst:.1g}, mass by mass"
    facts = {**methods[1].facts, "margin_disagreement": worst, "least_gain_margin": float(found.gain.min())}
    methods[1] = Method(methods[1].name, sweep, methods[1].answer + agreed, methods[1].misses, facts)
    return Comparison(row, question, tuple(methods))


def _read(
    name: str, cost: Cost, masses: np.ndarray, stable: np.ndarray, exact: Stretches, crossings: list[float]
) -> Method:
    """A grid's reading of what is stable, beside the exact one."""
    read = stable_stretches(masses, stable)
    truth = np.any([(low <= masses) & (masses <= high) for low, high in exact], axis=0)
    wrong_yes, wrong_no = masses[stable & ~truth], masses[~stable & truth]
    edges = sorted({end for stretch in read for end in stretch} - {float(masses[0]), float(masses[-1])})
    near = [min((abs(edge - crossing) for edge in edges), default=np.inf) for crossing in crossings]
    facts = {
        "read_stable_but_unstable": float(len(wrong_yes)),
        "read_unstable_but_stable": float(len(wrong_no)),
        "crossings": float(len(crossings)),
        "edges": float(len(edges)),
        "crossing_error_kg": float(max(near, default=0.0)),
    }
    misses = []
    if len(wrong_yes):
        misses.append(f"reads {_span(wrong_yes)} as stable, which is unstable ({len(wrong_yes)} points)")
    if len(wrong_no):
        misses.append(f"reads {_span(wrong_no)} as unstable, which is stable ({len(wrong_no)} points)")
    if crossings and not edges:
        misses.append(f"all {len(crossings)} crossings: {crossings[-1] - crossings[0]:.3g} kg apart, between points")
    elif crossings:
        misses.append(f"crossings off by up to {max(near):.2g} kg")
    return Method(name, cost, f"reads stable {_words(read)}", "; ".join(misses), facts)


def disagreement(closed: Loop, masses_kg: np.ndarray, found: Margins) -> float:
    """Largest relative difference between python-control's margins and those from exact crossings, mass by mass."""
    worst = 0.0
    for mass, gain, phase, modulus in zip(masses_kg, found.gain, found.phase_deg, found.modulus, strict=True):
        there = closed.at(float(mass))
        own = there.margins()
        nearest = min((own.gain_up, own.gain_down or np.inf), key=lambda factor: abs(np.log(factor)))
        pairs = [(gain, nearest), (abs(phase), own.phase_deg)]
        if there.stable:
            pairs.append((modulus, 1 / there.peak_sensitivity()))
        worst = max([worst, *(abs(one / other - 1) for one, other in pairs if np.isfinite(other))])
    return float(worst)


def compare_stability(rig: Rig, effort: Effort, row: str, question: str) -> Comparison:
    """Yes or no: the check inside the tuner against both grids."""
    ends = exact(0.0), exact(rig.high_kg)
    proof, answer = timed(lambda: is_stable_over(loop(rig.prototype).characteristic, *ends), 3 * effort.repeats)
    sweep, found = timed(rig.margins, effort.sweeps, warm=False)
    dense, fastest = timed(rig.growth, effort.repeats)
    between = "whatever happens between its points"
    return Comparison(
        row,
        question,
        (
            Method("proof: stable or not", proof, _yes(answer), facts={"stable": float(answer)}),
            Method(
                rig.sweep_name,
                sweep,
                _yes(found.read_stable.all()),
                between,
                {"stable": float(found.read_stable.all())},
            ),
            Method(rig.grid_name, dense, _yes((fastest < 0).all()), between, {"stable": float((fastest < 0).all())}),
        ),
    )


def compare_performance(rig: Rig, effort: Effort, row: str, question: str) -> Comparison:
    """Guaranteed bandwidth and peak sensitivity against margins alone, and against responses on a frequency grid."""
    limit = rig.prototype.goal.compliance_m_per_N
    proof, certificate = timed(rig.certificate, effort.repeats)
    guaranteed = certificate.guaranteed
    assert guaranteed is not None  # the prototypes compared here are stable
    sweep, found = timed(rig.margins, effort.sweeps, warm=False)
    curves, (sensitivity, compliance) = timed(rig.curves, 1, warm=False)
    swept_peak, grid_peak = 1 / float(found.modulus.min()), float(sensitivity.max())
    bandwidth = last_within(compliance.max(axis=0), limit)
    own, missed = guaranteed.peak_sensitivity, "peak sensitivity read {:.2g} % low"
    low = [100 * (1 - peak / own) for peak in (swept_peak, grid_peak)]
    over = 100 * (bandwidth / guaranteed.bandwidth_Hz - 1)
    off = f"bandwidth read {abs(over):.2g} % {'high' if over > 0 else 'low'}"
    return Comparison(
        row,
        question,
        (
            Method(
                "proof: ranges, bandwidth, peak sensitivity, certificate",
                proof,
                f"peak sensitivity at most {own:.6g}, bandwidth at least {guaranteed.bandwidth_Hz:.7g} Hz",
                facts={"peak_sensitivity": own, "bandwidth_Hz": guaranteed.bandwidth_Hz},
            ),
            Method(
                rig.sweep_name,
                sweep,
                f"peak sensitivity {swept_peak:.6g}",
                f"{missed.format(low[0])} (of the proved bound, which is rounded up by up to 0.01 %); no bandwidth",
                {"peak_sensitivity": swept_peak},
            ),
            Method(
                "  and responses at 401 frequencies",
                sweep + curves,
                f"on the frequency grid peak sensitivity {grid_peak:.6g}, bandwidth {bandwidth:.7g} Hz",
                f"{missed.format(low[1])}; {off}",
                {"peak_sensitivity": grid_peak, "bandwidth_Hz": bandwidth},
            ),
        ),
    )


def _yes(stable: bool) -> str:
    return "stable" if stable else "not stable"


def _words(stretches: Stretches) -> str:
    return " and ".join(f"{low:.7g} to {high:.7g} kg" for low, high in stretches) or "nowhere"


def _span(masses: np.ndarray) -> str:
    return f"{masses[0]:.4g} kg" if len(masses) == 1 else f"{masses[0]:.4g} to {masses[-1]:.4g} kg"
