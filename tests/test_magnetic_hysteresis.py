"""Magnetic hysteresis of a valve, driven slowly: Rayleigh's law, Madelung's rules, and plays by the hundred."""

from itertools import pairwise
from math import pi

import numpy as np
import pytest

from beamdesign.plant.effects import Site
from beamdesign.plant.effects.valve_hysteresis import MAGNETIC


def magnetised(currents: np.ndarray, **parameter: float) -> np.ndarray:
    """What the spool gets of a slow course of currents that begins at none, A."""
    state, passed = dict.fromkeys(MAGNETIC.states, 0.0), []
    for current in currents:
        site = Site({}, {}, parameter, state, {}, 0.0)
        passed.append(float(MAGNETIC.laws["spool_A"](float(current), site)))
        state = {name: at + 1e-4 * float(site.rate[name]) for name, at in state.items()}
    return np.array(passed)


def cycle(amplitude: float, points: int = 1200) -> np.ndarray:
    """Up from none, and round once and a quarter; the last `points` are a cycle that begins at the top."""
    return amplitude * np.sin(2 * pi * np.arange(1.25 * points + 1) / points)


@pytest.mark.parametrize(("half", "share"), [(1e-4, 0.5), (3e-5, 0.9)])
def test_large_magnetic_loops_have_the_stated_width_and_the_loss_of_rayleighs_law(half: float, share: float):
    """With largest threshold R = 2 w/s, plays of thresholds r lose 4 r (a - r) each: 4 a w - 16 w^2 / (3 s) in all.

    At a = R this is Rayleigh's own (4/3) nu a^3, nu = s / 2 R being the curvature of his initial curve.
    """
    largest = 2 * half / share
    for amplitude in (largest, 3 * largest):
        current = cycle(amplitude)
        passed = magnetised(current, half_width_A=half, held_share=share)
        loss = float(np.trapezoid(current[-1201:], passed[-1201:]))
        expected = 4 * amplitude * half - 16 * half**2 / (3 * share)
        assert loss == pytest.approx(expected, rel=2e-2)
        assert passed[300] == pytest.approx(amplitude - half, rel=1e-3)  # the initial curve, once all has given way
    assert [passed[600], passed[1200]] == pytest.approx([half, -half], rel=2e-2)
    assert 4 * largest * half - 16 * half**2 / (3 * share) == pytest.approx(4 / 3 * share / (2 * largest) * largest**3)


def test_small_magnetic_loops_grow_as_rayleigh_says():
    """Top (1 - s) a + nu a^2 and remanence nu a^2 / 2 with nu = s / 2 R; four plays for a continuum are within 15 %."""
    half, share = 1e-4, 0.6
    largest = 2 * half / share
    curvature = share / (2 * largest)
    amplitudes = np.linspace(0.4, 1.0, 7) * largest
    tops, remanent = [], []
    for amplitude in amplitudes:
        passed = magnetised(cycle(amplitude), half_width_A=half, held_share=share)
        tops.append(passed[300] - (1 - share) * amplitude)
        remanent.append((passed[600] - passed[1200]) / 2)
    np.testing.assert_allclose(tops, curvature * amplitudes**2, rtol=0.06)
    np.testing.assert_allclose(remanent, curvature * amplitudes**2 / 2, rtol=0.15)
    growth = np.polyfit(np.log(amplitudes), np.log(remanent), 1)[0]
    assert growth == pytest.approx(2.0, abs=0.2)
    faint = 0.05 * largest
    passed = magnetised(cycle(faint), half_width_A=half, held_share=share)[-1]
    assert passed == pytest.approx((1 - share) * faint, rel=1e-5)  # in 0.15 s the iron forgets no more


def test_a_magnetic_loop_closes_and_forgets_what_happened_within():
    """Madelung's rules, which friction after Dahl breaks: his minor loops drift."""
    half, legs = 1e-4, [0.0, 4e-4, -1e-4, 1e-4, -1e-4, 4e-4, 0.0]
    course = np.concatenate([a + (b - a) * (1 - np.cos(np.linspace(0, pi, 500))) / 2 for a, b in pairwise(legs)])
    passed = magnetised(course, half_width_A=half, held_share=0.8)
    bottom, again, top, once_more = (passed[500 * k - 1] for k in (2, 4, 1, 5))
    assert again == pytest.approx(bottom, abs=1e-3 * half)
    assert once_more == pytest.approx(top, abs=1e-3 * half)
    plain = magnetised(course[[k for k in range(3000) if not 1000 <= k < 2000]], half_width_A=half, held_share=0.8)
    np.testing.assert_allclose(passed[-500:], plain[-500:], atol=1e-3 * half)


def test_a_magnet_is_a_continuum_of_plays():
    """Against 400 plays, recursion of M. A. Krasnosel'skii and A. V. Pokrovskii (1983), under a wandering current."""
    half, share = 1e-4, 0.7
    thresholds = 2 * half / share * (np.arange(400) + 0.5) / 400
    lines = np.random.default_rng(2).standard_normal((2, 6))
    turns = 2 * pi * np.outer(np.arange(1, 7), np.arange(4000) / 4000)
    current = 1e-4 * (lines[0] @ np.sin(turns) + lines[1] @ (np.cos(turns) - 1))
    plays, expected = np.zeros(400), []
    for at in current:
        plays = np.clip(plays, at - thresholds, at + thresholds)
        expected.append((1 - share) * at + share * plays.mean())
    found = magnetised(current, half_width_A=half, held_share=share)
    assert np.std(current - expected) > 0.7 * half
    assert np.std(found - expected) < 0.03 * half
