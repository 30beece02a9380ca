"""How many candidates a second are proved inside the tuner, beside a grid of eigenvalues for each of them."""

import numpy as np
from comparison import Comparison, Cost, Effort, Method, timed
from grids import closed_loops, growth, margins, matrices, models

from beamdesign import Prototype
from beamdesign.controllers import Lag, Proportional
from beamdesign.controllers.protocol import form_of
from beamdesign.loop import Loop, close_loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.performance import prove
from beamdesign.proofs.rectangle import Rectangle

LARGEST_INNER_KG = 6.0
_SWEPT = 2
"""Candidates that the margin sweep is timed on."""

Candidate = tuple[Proportional | Lag, float]


def drawn(kind: str, count: int, low: np.ndarray, high: np.ndarray) -> list[Candidate]:
    """Random controllers (uniform in the logarithms) and inner end masses of a box, rounded as the tuner does."""
    points = np.random.default_rng(0).uniform(low, high, (count, len(low)))
    return [(form_of(kind).record(point[:-1]), round(float(point[-1]), 6)) for point in points]


def tuner_box(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the tuner's variables."""
    form = form_of(kind)
    return np.append(form.lower, 0.0), np.append(form.upper, LARGEST_INNER_KG)


def around(controller: Lag, inner_kg: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    """A box around a design, every figure within a share of its own."""
    figures = np.log([controller.gain_A_per_V, controller.pole_Hz, controller.zero_Hz])
    point = np.array([*figures, inner_kg])
    reach = np.array([share] * 3 + [share * inner_kg])
    return point - reach, point + reach


def compare_candidates(
    prototype: Prototype,
    candidates: list[Candidate],
    masses_kg: tuple[float, float],
    effort: Effort,
    row: str,
    question: str,
) -> Comparison:
    """Cost per candidate; the first method closes the loop in rationals and proves or refutes its stability."""
    rig, count, limit = paper_model(prototype), len(candidates), prototype.goal.peak_sensitivity
    grid, masses = matrices(rig), np.linspace(*masses_kg, effort.sweep)

    def closed() -> list[Loop]:
        return [close_loop(rig.plant(inner), controller) for controller, inner in candidates]

    def sampled() -> list[bool]:
        return [bool((growth(closed_loops(grid, *candidate, masses)) < 0).all()) for candidate in candidates]

    def swept() -> list[bool]:
        return [bool(margins(models(grid, *one, masses)).read_stable.all()) for one in candidates[:_SWEPT]]

    built, loops = timed(closed, 3, warm=False)
    ranges, asked = [Rectangle(found, *map(exact, masses_kg)) for found in loops], Asked("peak_sensitivity", limit)
    decided, proved = timed(lambda: [found.stable for found in ranges], 3)
    stable = [found for found, yes in zip(ranges, proved, strict=True) if yes]
    full, kept = timed(lambda: [prove(found, asked).holds for found in stable], 1, warm=False)
    read, seen = timed(sampled, 1, warm=False)
    margin_cost, _ = timed(swept, 1, warm=False)
    wrong = sum(one != other for one, other in zip(seen, proved, strict=True))
    methods = [
        Method(
            "proof: loop and its stability",
            (built + decided) / count,
            f"{_rate(built / count + decided / count)}; {sum(proved)} of {count} are stable over the range",
            facts={"stable": float(sum(proved)), "candidates": float(count)},
        ),
        Method("  its stability alone", decided / count, _rate(decided / count)),
    ]
    if stable:
        cost = full / len(stable)
        methods.append(
            Method(
                "  stability and peak sensitivity, stable ones",
                cost,
                f"{_rate(cost)}; {sum(kept)} of {len(stable)} keep peak sensitivity {limit:g}",
                facts={"kept": float(sum(kept))},
            )
        )
    methods += [
        Method(
            f"numpy, eigenvalues at {effort.sweep} masses",
            read / count,
            _rate(read / count),
            f"judges {wrong} of {count} otherwise; says nothing between its points",
            {"judged_otherwise": float(wrong)},
        ),
        Method(
            f"python-control, margins at {effort.sweep} masses",
            margin_cost / min(_SWEPT, count),
            f"{_rate(margin_cost / min(_SWEPT, count))} ({_SWEPT} candidates timed)",
            "whatever happens between its points",
        ),
    ]
    return Comparison(row, question, tuple(methods))


def _rate(each: Cost) -> str:
    by_cpu, by_clock = (f"{1 / s:.3g}" if s > 0.01 else f"{1 / s:.0f}" for s in (each.cpu_s, each.wall_s))
    return f"{by_cpu} a second of CPU time ({by_clock} by the clock)"
