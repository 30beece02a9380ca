"""What a proof over a box of tolerances costs: against the number of parameters, and near the largest stable box.

Run as `python studies/benchmarks/box_cost.py`; all figures of the tables are measured in that one run.
"""

import argparse
import re
from dataclasses import replace
from itertools import product
from time import perf_counter

import numpy as np
from flint import ctx, fmpq

from beamdesign.controllers import Lag
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_member import undamping
from beamdesign.proofs.branch import Search
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.statement import PolynomialFamily
from beamdesign.proofs.tolerance_box import largest_scaling, tolerance_box
from beamdesign.proofs.value_set import control_points
from beamdesign.proofs.zero_exclusion import PRECISION_BITS, held, pieces
from beamdesign.prototype import Payload, Tolerance
from beamdesign.validation.paper_rig import paper_prototype

RIG = paper_prototype().but(
    name="published rig, lag 1.7/20 Hz at 50 mA/V",
    controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
    payload=Payload(outer_end_mass_kg=(0.0, 6.8), inner_end_mass_kg=4.5),
    tolerance=Tolerance(
        stiffness=0.03,
        effective_mass=0.02,
        beam_damping_ratio=0.2,
        oil_stiffness=0.1,
        piston_area=0.005,
        flow_gain=0.05,
        leakage=0.2,
        valve_natural_frequency=0.05,
        valve_damping_ratio=0.1,
        sensor_gain=0.005,
    ),
)
"""Tolerances as in the rigs' prototypes: relative standard deviations."""

SPREAD = {"controller_gain": 0.005, "controller_pole": 0.01, "controller_zero": 0.01}
ORDER = (
    "outer_end_mass",
    "flow_gain",
    "outer_stiffness",
    "valve_damping_ratio",
    "oil_stiffness",
    "valve_frequency",
    "inner_stiffness",
    "outer_mass",
    "leakage",
    "inner_mass",
    "outer_damping",
    "inner_damping",
    "piston_area",
    "sensor_gain",
    "controller_gain",
    "controller_pole",
    "controller_zero",
    "delay",
)
BUDGET = 4000


def unstructured(family: PolynomialFamily) -> PolynomialFamily:
    """The same polynomial as one leaf in all parameters: hulls of all corners at once."""
    text = re.sub(r"\*?transport\b", "", family.p).replace("(*", "(")
    for name, leaf in (family.leaves or {}).items():
        text = re.sub(rf"\b{name}\b", f"({leaf})", text)
    for name, kind, members in family.groups:
        text = re.sub(rf"\b{name}\b", "(" + (" + " if kind == "sum" else "*").join(members) + ")", text)
    values = {name: value for name, value in family.values.items() if name != "delay"}
    return PolynomialFamily(family.name, text, values)


def measured(family: PolynomialFamily, box: Box) -> tuple[str, float]:
    """Pieces, seconds and outcome of one proof as a part of a row, and all its seconds."""
    start = perf_counter()
    statement = family.over(box.ranges)
    search = Search(statement)
    search.run(BUDGET)
    searched = perf_counter()
    with ctx.workprec(PRECISION_BITS):
        found = held([*pieces(statement, search.tree)])
    proved = perf_counter()
    outcome = "proved" if all(found) else "open"
    row = (
        f"{control_points(statement):>7}{len(found):>7}{searched - start:>10.2f}{proved - searched:>9.2f}  {outcome:<7}"
    )
    return row, proved - start


def corners(family: PolynomialFamily, box: Box) -> float:
    """Seconds for the roots of every corner in floats, which prove nothing of what lies between."""
    statement = family.over(box.ranges)
    start = perf_counter()
    batch = []
    for corner in product((0.0, 1.0), repeat=len(statement.varying)):
        batch.append(corner)
        if len(batch) == 4096:
            undamping(statement, np.array(batch))
            batch.clear()
    if batch:
        undamping(statement, np.array(batch))
    return perf_counter() - start


def against_parameters(sigmas: float, longest: float) -> None:
    """Table: one more figure per row, with the structure of the loop and without."""
    print(f"{RIG.name}, {sigmas:g} standard deviations and 0 to 6.8 kg, delay 0 to 20 microseconds; s are seconds")
    print(f"{'':21}|{'expression with structure':^42}|{'all corners at once':^42}| roots of")
    head = f"{'points':>7}{'pieces':>7}{'search s':>10}{'proof s':>9}  {'':<7}"
    print(f"{'figures':>8}{'variables':>11}  |{head}|{head}| corners s")
    box = tolerance_box(RIG, sigmas, delay_s=(0.0, 2e-5), spread=SPREAD)
    family, flat, tired = rig_family(RIG), unstructured(rig_family(RIG)), False
    for count in range(1, len(ORDER) + 1):
        part = _only(box, ORDER[:count])
        row, _ = measured(family, part)
        other = ""
        if not tired and "delay" not in part.names:
            other, seconds = measured(flat, part)
            tired = seconds > longest
        variables = len(family.over(part.ranges).varying)
        late = f"{corners(family, part):>9.2f}" if variables <= 16 else ""
        print(f"{count:>8}{variables:>11}  |{row}|{other:<42}|{late}   + {ORDER[count - 1]}")


def near_the_limit() -> None:
    """Table: all figures, boxes drawn out towards the least factor that is refuted."""
    box = tolerance_box(RIG, 1.0, spread=SPREAD)
    start = perf_counter()
    found = largest_scaling(RIG, box)
    print(f"\n{len(box.names)} figures at once, scaled; {found.reason} ({perf_counter() - start:.1f} s for both)")
    print(f"{'factor':>8}  {'points':>7}{'pieces':>7}{'search s':>10}{'proof s':>9}")
    assert found.refuted is not None
    for share in (0.25, 0.5, 0.75, 0.9, 0.95, 0.98, 0.99):
        factor = fmpq(round(1000 * share * found.refuted), 1000)
        row, _ = measured(rig_family(RIG), box.scaled(factor))
        print(f"{int(factor.p) / int(factor.q):>8.3f}  {row}")


def _only(box: Box, names: tuple[str, ...]) -> Box:
    return replace(
        box,
        ranges={name: ends for name, ends in box.ranges.items() if name in names},
        nominal={name: value for name, value in box.nominal.items() if name in names},
    )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sigmas", type=float, default=2.0, help="standard deviations in the first table")
    parser.add_argument("--longest", type=float, default=20.0, help="seconds after which the flat form is given up")
    options = parser.parse_args()
    against_parameters(options.sigmas, options.longest)
    near_the_limit()


if __name__ == "__main__":
    main()
