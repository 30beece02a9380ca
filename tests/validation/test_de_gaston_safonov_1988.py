"""A published multiloop stability margin for three uncertain parameters.

R. R. E. de Gaston and M. G. Safonov, "Exact calculation of the multiloop stability margin", IEEE Transactions on
Automatic Control 33 (1988) 156-171: plant 800 (1 + 0.1 d1) / (s (s + 4 + 0.2 d2) (s + 6 + 0.3 d3)), compensator
(s + 2) / (s + 10), unit feedback. The margin, the largest k for which all |d| < k are stable, is 3.417.
"""

import pytest
from flint import fmpq

from beamdesign import check
from beamdesign.polynomial import Affine, crossings, exact
from beamdesign.proofs.box import box_of
from beamdesign.proofs.box_member import member
from beamdesign.proofs.statement import PolynomialFamily
from beamdesign.proofs.tolerance_box import largest_scaling

FAMILY = PolynomialFamily(
    "de Gaston and Safonov",
    "s*(s + 10)*(s + 4 + 2*d2/10)*(s + 6 + 3*d3/10) + 800*(1 + d1/10)*(s + 2)",
    {"d1": fmpq(0), "d2": fmpq(0), "d3": fmpq(0)},
)
MARGIN = 3.417


def test_margin():
    found = largest_scaling(FAMILY, box_of(dict.fromkeys(FAMILY.values, (-1, 1))), within=2e-4)
    assert found.proved < MARGIN + 5e-4
    assert found.refuted > MARGIN - 5e-4
    assert (found.proved, found.refuted) == pytest.approx((MARGIN, MARGIN), abs=1.5e-3)
    assert check(found.verdict.certificate).valid


def test_worst_corner():
    """The gain at its largest and both poles at their slowest: there d1 alone, by exact crossings, reaches it."""
    corner = {"d2": exact(-MARGIN), "d3": exact(-MARGIN)}
    constant, slope = (member(FAMILY.over({}), {"d1": fmpq(d), **corner}).plain for d in (0, 1))
    least = min(c.value for c in crossings(Affine(constant, slope - constant)) if c.value > 0)
    assert least == pytest.approx(MARGIN, abs=2e-3)
