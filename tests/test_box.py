"""Stability over a box of parameters: against other theory, against sampling, and where short cuts go wrong."""

import re
from dataclasses import replace
from itertools import product
from math import atan, pi, sqrt

import numpy as np
import pytest
from flint import acb, arb, ctx, fmpq, fmpq_poly
from scipy.spatial import Delaunay

from beamdesign import check
from beamdesign.loop import loop
from beamdesign.polynomial import even_odd, exact, is_hurwitz, squared_magnitude
from beamdesign.polynomial import roots as roots_of
from beamdesign.proofs.balls import balls
from beamdesign.proofs.box import Box, box_of, certify_box
from beamdesign.proofs.box_member import Quasipolynomial, unstable_roots
from beamdesign.proofs.frames import Between, Cell, Frames
from beamdesign.proofs.stability import stable_ranges
from beamdesign.proofs.statement import PolynomialFamily
from beamdesign.proofs.tolerance_box import largest_scaling, scaling_of_each


def family(p: str, **values: float) -> PolynomialFamily:
    """A family without structure."""
    return PolynomialFamily("test", p, {name: exact(value) for name, value in values.items()})


# Against theory.


def kharitonov(low: list[fmpq], high: list[fmpq]) -> bool:
    """V. L. Kharitonov (1978): an interval polynomial is stable if and only if four of its corners are."""
    patterns = ("llhh", "hhll", "lhhl", "hllh")
    return all(
        is_hurwitz(fmpq_poly([(low if pattern[i % 4] == "l" else high)[i] for i in range(len(low))]))
        for pattern in patterns
    )


def test_interval_polynomials_agree_with_kharitonov():
    rng = np.random.default_rng(11)
    verdicts = []
    for _ in range(40):
        roots = np.concatenate([-rng.uniform(0.3, 2, 1), -rng.uniform(0.1, 1, 1) + 1j * rng.uniform(0.5, 2, 1)])
        centre = np.poly([*roots, roots[1].conjugate(), -1.0]).real[::-1]
        by = rng.uniform(0.02, 0.3, 5)
        low = [exact(round(float(c * (1 - b)), 4)) for c, b in zip(centre, by, strict=True)]
        high = [exact(round(float(c * (1 + b)), 4)) for c, b in zip(centre, by, strict=True)]
        p = " + ".join(f"a{i}*s**{i}" for i in range(5))
        box = box_of({f"a{i}": (low[i], high[i]) for i in range(5)})
        verdict = certify_box(family(p, **{f"a{i}": 1.0 for i in range(5)}), box, budget=2000, volumes=False)
        assert verdict.stable is not None
        assert verdict.stable == kharitonov(low, high)
        verdicts.append(verdict.stable)
    assert 5 < sum(verdicts) < 35


def test_one_parameter_agrees_with_the_exact_crossings(remedy):
    ranges = stable_ranges(loop(remedy).characteristic, fmpq(0), fmpq(20))
    least, most = (crossing.value for crossing in ranges.crossings)
    assert certify_box(remedy, box_of({"outer_end_mass": (least * (1 + 1e-6), most * (1 - 1e-6))})).stable is True
    for beyond in ((least * (1 - 1e-3), 10.0), (10.0, most * (1 + 1e-3))):
        verdict = certify_box(remedy, box_of({"outer_end_mass": beyond}))
        assert verdict.stable is False
        assert not loop(remedy).at(float(verdict.unstable_point["outer_end_mass"])).stable
    whole = certify_box(remedy, box_of({"outer_end_mass": (0.0, 20.0)}))
    assert whole.stable is False
    assert float(whole.volumes.stable.p) / float(whole.volumes.stable.q) == pytest.approx((most - least) / 20, abs=2e-4)


# Traps.


def test_margin_that_every_frequency_grid_overestimates():
    """p = s^3 + (2 - q1) s^2 + s + (1 + q2)(1 + q3), |q| <= r.

    Im p(jw) = w (1 - w^2) for every member: a root can cross the axis at w = 1 and nowhere else. On a grid without
    exactly this frequency no perturbation of any size reaches zero, so that the margin seems infinite. By Routh the
    member is stable if 2 - q1 > (1 + q2)(1 + q3) > 0, worst at q = (r, r, r): r^2 + 3 r - 1 = 0.
    """
    margin = (sqrt(13) - 3) / 2
    three = family("s**3 + (2 - q1)*s**2 + s + (1 + q2)*(1 + q3)", q1=0, q2=0, q3=0)
    names = ("q1", "q2", "q3")

    grid = np.geomspace(0.01, 100, 2000)
    corners = np.array(list(product((-1.0, 1.0), repeat=3))) * 3 * margin
    at = (
        (1j * grid) ** 3
        + (2 - corners[:, :1]) * (1j * grid) ** 2
        + 1j * grid
        + (1 + corners[:, 1:2]) * (1 + corners[:, 2:])
    )
    assert np.abs(at.imag).min() > 0  # three times the margin, and all corners on one side of zero at every frequency
    assert np.all(np.sign(at.imag) == np.sign(at.imag[0]))

    found = largest_scaling(three, box_of(dict.fromkeys(names, (-1, 1))), within=1e-3)
    assert found.proved < margin < found.refuted < 1.002 * margin
    assert found.proved > 0.998 * margin
    assert check(found.verdict.certificate).valid


def test_worst_member_inside_the_range():
    """q^2 - q + c has its least value, c - 1/4, in the middle: both ends of the range are stable for c > 0."""
    for c, stable in ((0.2501, True), (0.2499, False)):
        verdict = certify_box(family(f"s**2 + (q**2 - q + {round(c * 10**4)}/10000)*s + 1", q=0), box_of({"q": (0, 1)}))
        assert verdict.stable is stable
    assert verdict.unstable_point["q"] == fmpq(1, 2)


def test_skewed_range_about_its_nominal_value():
    """s^3 + 2 s^2 + s + q is stable for 0 < q < 2; from 0.6 the upper side of [0.5, 1] gets there at factor 3.5."""
    cubic = family("s**3 + 2*s**2 + s + q", q=0.6)
    found = largest_scaling(cubic, box_of({"q": (0.5, 1.0)}, {"q": 0.6}), within=1e-3)
    assert found.proved < 3.5 < found.refuted < 3.504
    assert found.proved > 3.49
    assert certify_box(cubic, box_of({"q": (0.01, 1.99)})).stable is True  # its centre is far from either end
    assert certify_box(cubic, box_of({"q": (0.01, 2.01)})).stable is False


def test_how_far_each_range_alone_goes():
    """s^3 + a s^2 + b s + c is stable where a b > c (Routh): each alone against the worst ends of both others."""
    cubic = family("s**3 + a*s**2 + b*s + c", a=2, b=1, c=1)
    found = scaling_of_each(cubic, box_of({"a": (1.6, 2.4), "b": (0.9, 1.1), "c": (0.8, 1.2)}), within=1e-3)
    margins = {"a": (2 - 1.2 / 0.9) / 0.4, "c": (1.6 * 0.9 - 1) / 0.2, "b": (1 - 1.2 / 1.6) / 0.1}
    assert [*found] == [*margins]
    for name, margin in margins.items():
        assert 0.998 * margin < found[name].proved < margin <= found[name].refuted * (1 + 1e-12) < 1.002 * margin


def test_root_at_zero_frequency():
    cubic = family("s**3 + 2*s**2 + s + q", q=0.5)
    assert certify_box(cubic, box_of({"q": (1e-6, 1.0)})).stable is True
    verdict = certify_box(cubic, box_of({"q": (-0.1, 1.0)}))
    assert verdict.stable is False
    assert verdict.unstable_point["q"] < 0
    touching = certify_box(cubic, box_of({"q": (0.0, 1.0)}))
    assert touching.stable is False
    assert touching.unstable_point["q"] == 0


def test_degree_drop():
    """q s^3 + s^2 + s + 1 is stable for 0 < q < 1; at q = 0 a root passes through infinity, not through the axis."""
    dropping = family("q*s**3 + s**2 + s + 1", q=0.1)
    assert certify_box(dropping, box_of({"q": (1e-6, 0.9)})).stable is True
    assert certify_box(dropping, box_of({"q": (-0.1, 0.9)})).stable is False
    touching = certify_box(dropping, box_of({"q": (0.0, 0.9)}))
    assert touching.stable is False
    assert "infinity" in touching.reason


def test_tangency_is_not_proved():
    """(s + 1)(s^2 + (q - 1/3)^2 s + 1) touches the axis at q = 1/3 only, which no midpoint of the search meets."""
    square = family("(s + 1)*(s**2 + (9*q**2 - 6*q + 1)*s + 1)", q=0.0)
    verdict = certify_box(square, box_of({"q": (0, 1)}), budget=2000)
    assert verdict.stable is None
    assert 0 < verdict.volumes.undecided < fmpq(1, 100)
    assert verdict.volumes.unstable == 0
    low, high = map(float, re.search(r"between (\S+) and (\S+) Hz", verdict.reason).groups())
    assert low < 1 / (2 * pi) < high < 1.1 * low


def test_volumes():
    """Stable for 0 < q < 2, of [-1, 4]: 2/5, bracketed exactly."""
    verdict = certify_box(family("s**3 + 2*s**2 + s + q", q=1.0), box_of({"q": (-1, 4)}))
    assert verdict.stable is False
    stable, unstable, undecided = verdict.volumes
    assert stable + unstable + undecided == 1
    assert stable <= fmpq(2, 5) <= stable + undecided
    assert unstable <= fmpq(3, 5) <= unstable + undecided
    assert undecided < fmpq(1, 1000)


# Delay.

DELAYED = PolynomialFamily(
    "integrator and lag", "a + k*late", {"K": exact(1.0), "T": fmpq(0)}, {"a": "s**2 + s", "k": "K"}, (), {"late": "T"}
)


def test_number_of_unstable_roots_with_a_delay():
    """s (s + 1) + sqrt(2) exp(-sT) meets the axis at w = 1 alone: two roots more at T = pi / 4 and every 2 pi after."""
    a = fmpq_poly([0, 1, 1])
    with ctx.workprec(96):
        for delay in (0.1, 0.7, 0.8, 5.0, 7.0, 7.1, 13.3, 13.4):
            one = Quasipolynomial(a, fmpq_poly([exact(sqrt(2))]), exact(delay))
            crossed = sum(pi / 4 + 2 * pi * i < delay for i in range(5))
            assert unstable_roots(one) == 2 * crossed


def test_number_of_unstable_roots_without_a_delay():
    rng = np.random.default_rng(2)
    with ctx.workprec(96):
        for degree in (1, 2, 3, 5, 8):
            plain = fmpq_poly([exact(round(c, 3)) for c in rng.normal(size=degree)] + [1])
            expected = sum(root.real > 0 for root in roots_of(plain))
            assert unstable_roots(Quasipolynomial(plain, fmpq_poly([0]), fmpq(0))) == expected


def test_delay_margin_is_phase_margin_over_crossover():
    """L = K exp(-sT) / (s (s + 1)): crossover where K^2 = w^2 (w^2 + 1), phase margin pi / 2 - atan w."""
    for gain in (0.3, 1.0, 2.0):
        crossover = sqrt((sqrt(1 + 4 * gain**2) - 1) / 2)
        margin = (pi / 2 - atan(crossover)) / crossover
        fixed = PolynomialFamily("L", DELAYED.p, {"K": exact(gain), "T": fmpq(0)}, DELAYED.leaves, (), DELAYED.delays)
        assert certify_box(fixed, box_of({"T": (0.0, 0.999 * margin)})).stable is True
        refuted = certify_box(fixed, box_of({"T": (0.0, 1.002 * margin)}))
        assert refuted.stable is False
        assert check(refuted.certificate).valid


def test_delay_and_gain_together():
    """The margin falls with the gain, so the box's worst corner is the largest of both."""
    crossover = sqrt((sqrt(1 + 4 * 1.5**2) - 1) / 2)
    margin = (pi / 2 - atan(crossover)) / crossover
    assert certify_box(DELAYED, box_of({"K": (0.5, 1.5), "T": (0.1, 0.99 * margin)})).stable is True
    assert certify_box(DELAYED, box_of({"K": (0.5, 1.5), "T": (0.1, 1.01 * margin)})).stable is False


def test_neutral_type_is_refused():
    with pytest.raises(ValueError, match="neutral"):
        PolynomialFamily("", "a + k*late", {"T": fmpq(0)}, {"a": "s + 1", "k": "s/2"}, (), {"late": "T"}).over(
            {"T": (fmpq(0), fmpq(1))}
        )


@pytest.mark.parametrize("count", [18, 70])
def test_too_many_control_points_are_refused(count: int):
    names = [f"q{i}" for i in range(count)]
    leaves = {f"leaf{i}": f"1 + {name}" for i, name in enumerate(names)}
    wide = PolynomialFamily("wide", "s + " + "*".join(leaves), dict.fromkeys(names, fmpq(0)), leaves)
    with pytest.raises(ValueError, match=f"{2**count + 1} control points"):
        certify_box(wide, box_of(dict.fromkeys(names, (0.0, 1.0))))


def test_what_lies_along_an_axis_is_two_points_to_prover_and_check():
    """A sum of eighteen intervals is one interval; the check refused it for 2^18 points."""
    names = [f"q{i}" for i in range(18)]
    sum_of_all = PolynomialFamily("sum", "leaf", dict.fromkeys(names, fmpq(0)), {"leaf": " + ".join(["s + 1", *names])})
    assert check(certify_box(sum_of_all, box_of(dict.fromkeys(names, (0.0, 1.0)))).certificate).valid


def test_thousands_may_be_added_up():
    """As several effects together do; the tree of such a sum is nested as deeply as it is long."""
    many = PolynomialFamily("many", " + ".join(["k"] + ["a"] * 2000), {"K": fmpq(1)}, {"a": "s + 1", "k": "K"})
    assert certify_box(many, box_of({"K": (1.0, 2.0)})).stable
    assert certify_box(many, box_of({"K": (-2001.0, 2.0)})).stable is False  # s = -(2000 + K) / 2000


def test_a_delay_that_does_not_vary_is_one_point_to_prover_and_check():
    """The check counted the corners of an arc for it, and refused what had been proved."""
    names = [f"q{i}" for i in range(15)]
    leaves = {f"leaf{i}": f"1 + {name}" for i, name in enumerate(names)}
    values = dict.fromkeys(names, fmpq(0)) | {"T": fmpq(0)}
    late = PolynomialFamily(
        "late", "alone + late*" + "*".join(leaves), values, {"alone": "s", **leaves}, (), {"late": "T"}
    )
    verdict = certify_box(late, box_of(dict.fromkeys(names, (0.0, 0.01))))
    assert verdict.stable
    assert check(verdict.certificate).valid


LAGGING = PolynomialFamily(
    "a beam behind a lag",
    "lag*beam + push",
    dict.fromkeys("vcKk", fmpq(1)),
    {"lag": "1 + s/v", "beam": "s**2 + c*s + K", "push": "k"},
    divisors=("lag",),
)


def lagging(share: float) -> Box:
    """Its ranges, with k up to a share of what Routh's test leaves: c v + c^2 + c K / v, least c (c + 2 sqrt(K))."""
    most = 0.02 * (0.02 + 2 * sqrt(0.9))
    return box_of({"v": (0.7, 1.4), "c": (0.02, 0.06), "K": (0.9, 1.1), "k": (0, round(share * most, 7))})


def test_a_lag_that_p_is_divided_by_leaves_what_routh_does():
    """The lag turns the beam, whose stiffness and mass cancel, by more than its damping: ten times the pieces."""
    within, beyond = lagging(0.98), lagging(1.001)
    verdict = certify_box(LAGGING, within, budget=100, volumes=False)
    assert verdict.stable
    assert check(verdict.certificate).valid
    assert certify_box(replace(LAGGING, divisors=()), within, budget=400, volumes=False).stable is None
    assert certify_box(LAGGING, beyond, budget=4000, volumes=False).stable is False
    # No tree is found where one should not be, the search for unstable members left out.
    assert certify_box(LAGGING, beyond, budget=4000, volumes=False, searched=True).stable is not True


def test_what_is_no_factor_of_one_summand_alone_is_not_divided_by():
    for p, bound in (("lag*beam + lag*push", ()), ("beam + lag*push + lag", ()), ("lag*beam + push", (("lag",),))):
        with pytest.raises(ValueError, match="p cannot be divided by lag"):
            certify_box(replace(LAGGING, p=p, bound=bound), lagging(0.5))


# Balls in floats.


def test_inverses_of_a_hull_lie_in_the_hull_of_its_inverses():
    """Means of points within a right angle, by Qhull's hull; exact points within the radius; others are nowhere."""
    random = np.random.default_rng(7)
    points = random.uniform(0.5, 2.0, 5) * np.exp(1j * random.uniform(0.3, 0.3 + 0.45 * pi, 5))
    given = balls([acb(one) for one in points]).shaped((1, -1))
    found = given.inverted()
    hull = Delaunay(np.column_stack([found.middle[0].real, found.middle[0].imag]))
    weights = random.dirichlet(0.5 * np.ones(5), 2000)
    inverse = 1 / (weights @ points)
    assert (hull.find_simplex(np.column_stack([inverse.real, inverse.imag]), tol=1e-9) >= 0).all()
    i, j = np.triu_indices(5)
    for middle, radius, a, b in zip(found.middle[0], found.radius[0], points[i], points[j], strict=True):
        (x, y), (u, v) = ([fmpq(*part.as_integer_ratio()) for part in (one.real, one.imag)] for one in (a, b))
        below = 2 * (x * u + y * v)
        off = abs(acb(arb((x + u) / below), arb(-(y + v) / below)) - acb(middle))
        assert off < arb(radius) < 1e-14
    assert np.isinf(balls([acb(1), acb(0, 1)]).shaped((1, -1)).inverted().radius[0, 1])


def test_an_inverse_is_bounded_between_frequencies():
    """Size and derivatives of 1 / (s^2 + c s + K) on the axis over a cell, against those of its members in floats."""
    beam = replace(LAGGING, divisors=("beam",))
    one = beam.over(box_of({"c": (0.5, 0.6), "K": (1.0, 1.2), "v": (1.0, 1.0), "k": (1.0, 1.0)}).ranges)
    (node,) = (part for part in one.summands[1].parts if part.kind == "inverse")
    w = [fmpq(9, 10), fmpq(11, 10)]
    frames = Frames(one, [(Cell(one, {"c": (fmpq(0), fmpq(1)), "K": (fmpq(0), fmpq(1))}), at) for at in w])
    bounds = frames.growth(Between(np.array([0]), np.array([1]), np.array([0.2**2 / 8 * (1 + 1e-9)])), node)
    at = np.linspace(0.9, 1.1, 101)
    largest = np.zeros(3)
    for c, stiffness in product((0.5, 0.55, 0.6), (1.0, 1.1, 1.2)):
        f, df, ddf = stiffness - at**2 + 1j * c * at, -2 * at + 1j * c, -2.0
        values = (1 / f, -df / f**2, 2 * df**2 / f**3 - ddf / f**2)
        largest = np.maximum(largest, [np.abs(value).max() for value in values])
    for bound, seen in zip(bounds, largest, strict=True):
        assert seen <= bound.item() < 10 * seen


def test_balls_hold_what_they_stand_for():
    """Against exact rationals: sums that cancel to a part in 1e12."""
    random = np.random.default_rng(3)

    def some(count: int) -> list[tuple[fmpq, fmpq]]:
        parts = random.integers(-(10**18), 10**18, size=(count, 2))
        return [(fmpq(int(a), 7 * 10**18), fmpq(int(b), 9 * 10**9)) for a, b in parts]

    def times(a: tuple[fmpq, fmpq], b: tuple[fmpq, fmpq]) -> tuple[fmpq, fmpq]:
        return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]

    def as_it_is(value: float) -> fmpq:
        return fmpq(*float(value).as_integer_ratio())

    one, two, near = some(5), some(4), [(fmpq(10**12 + k, 3), fmpq(-k, 10**60)) for k in range(3)]
    away = [(-a, b + 1) for a, b in near]
    a, b, c, d = (balls([acb(arb(x), arb(y)) for x, y in points]) for points in (one, two, near, away))
    found = (a * b * b) * (c + d)
    exact_ones = [
        times(times(times(p, q), r), (s[0] + t[0], s[1] + t[1])) for p, q, r, s, t in product(one, two, two, near, away)
    ]
    assert found.middle.shape == (len(exact_ones),)
    for middle, radius, (x, y) in zip(found.middle, found.radius, exact_ones, strict=True):
        assert (as_it_is(middle.real) - x) ** 2 + (as_it_is(middle.imag) - y) ** 2 <= as_it_is(radius) ** 2
        assert arb(x * x + y * y).sqrt() <= found.largest
    for direction in ((1, 0), (-37, 999)):
        least = min(direction[0] * x + direction[1] * y for x, y in exact_ones)
        assert as_it_is(found.along(*direction)) <= least
    assert found.radius.max() < 1e-3 * found.size.max()


def test_leaves_lie_within_their_bounds_where_their_terms_cancel():
    """Values and derivatives against exact rationals, at and near roots that lie on the axis."""

    def as_it_is(value: np.ndarray) -> fmpq:
        return fmpq(*value.item().as_integer_ratio())

    leaves = {"on_axis": "(s**2 + q)**4", "beside": "(s**2 + 2*s/1000 + q)**2*(s + 10)**3"}
    free = PolynomialFamily("f", "on_axis*beside", {"q": fmpq(1)}, leaves)
    wide = free.over({"q": (fmpq(999_999, 10**6), fmpq(1_000_001, 10**6))})
    w = [fmpq(0), fmpq(2, 3), fmpq(1), fmpq(10**9 + 1, 10**9), fmpq(31_415, 10)]
    every = np.arange(len(w))
    over_cell = Frames(wide, [(Cell(wide, {"q": (fmpq(0), fmpq(1))}), one) for one in w])
    for q in (fmpq(999_999, 10**6), fmpq(1), fmpq(1_000_001, 10**6)):
        fixed = free.over({"q": (q, q)})
        here = Frames(fixed, [(Cell(fixed, {}), one) for one in w])
        for node in fixed.body.parts:
            leaf, found = fixed.leaf_at(node.name, {"q": q}), here.points(node)
            even, odd = even_odd(leaf)
            _, *slopes = over_cell.growth(Between(every, every, 0.0 * every), node)
            for k, one in enumerate(w):
                away = as_it_is(found.middle[k].real) - even(one**2), as_it_is(found.middle[k].imag) - one * odd(one**2)
                assert away[0] ** 2 + away[1] ** 2 <= as_it_is(found.radius[k]) ** 2
                for derivative, most in zip((leaf.derivative(), leaf.derivative().derivative()), slopes, strict=True):
                    assert squared_magnitude(derivative)(one**2) <= as_it_is(most[k]) ** 2
