"""Laws of the true rig's parts, each checked on its own."""

from math import copysign, exp, log1p, sqrt

from numba import njit

ATMOSPHERE = 101325.0


@njit(cache=True, error_model="numpy")
def stribeck(speed: float, coulomb: float, breakaway: float, stribeck_speed: float, power: float) -> float:
    """Friction of steady sliding without its viscous part, N."""
    return coulomb + (breakaway - coulomb) * exp(-(abs(speed / stribeck_speed) ** power))


@njit(cache=True, error_model="numpy")
def orifice(drop: float, laminar: float) -> float:
    """Signed root of a pressure drop, straight below `laminar` (Pa)."""
    return drop / sqrt(abs(drop) + laminar)


@njit(cache=True, error_model="numpy")
def aerated(pressure: float, bulk: float, air: float, exponent: float, saturation: float) -> float:
    """Bulk modulus of oil with free air, Pa (Wylie), of which Henry's law dissolves a share that grows with pressure.

    Args:
        pressure: gauge, Pa.
        bulk: of the oil, Pa.
        air: volume at one atmosphere over that of the mixture.
        exponent: polytropic.
        saturation: absolute pressure at which nothing is left free, Pa.
    """
    absolute = max(pressure + ATMOSPHERE, 2e4)
    free = air * max(0.0, 1.0 - absolute / saturation)
    gas = free * (ATMOSPHERE / absolute) ** (1.0 / exponent)
    share = gas / (1.0 - air + gas)
    return bulk / (1.0 + share * (bulk / (exponent * absolute) - 1.0))


@njit(cache=True, error_model="numpy")
def softplus(x: float) -> float:
    """log(1 + exp(x)) without overflow."""
    return x + log1p(exp(-x)) if x > 0 else log1p(exp(x))


@njit(cache=True, error_model="numpy")
def overlapped(spool: float, overlap: float, rounding: float) -> float:
    """Opening of a spool whose lands overlap the ports, edges rounded over `rounding` times the overlap."""
    width = rounding * overlap
    return width * (softplus((spool - overlap) / width) - softplus((-spool - overlap) / width))


@njit(cache=True, error_model="numpy")
def knee(demand: float, limit: float, sharpness: float) -> float:
    """What an amplifier gives of a demand: its limit is reached gradually."""
    return demand / (1.0 + abs(demand / limit) ** sharpness) ** (1.0 / sharpness)


@njit(cache=True, error_model="numpy")
def played(given: float, held: float, half: float) -> float:
    """Play (backlash) operator: what lags `given` by at most `half`."""
    return min(max(held, given - half), given + half)


@njit(cache=True, error_model="numpy")
def contact(apart: float, closing: float, play: float, stiffness: float, loss: float) -> float:
    """Force across a joint with play: Hertzian faces that only press (Hunt and Crossley), N.

    Args:
        apart: of rod and joint from the middle of the play, m.
        closing: its rate, m/s.
        play: from face to face, m.
        stiffness: N/m^1.5.
        loss: s/m.
    """
    depth = abs(apart) - 0.5 * play
    if depth <= 0.0:
        return 0.0
    side = copysign(1.0, apart)
    return side * max(0.0, stiffness * depth * sqrt(depth) * (1.0 + 1.5 * loss * side * closing))


@njit(cache=True, error_model="numpy")
def flanks(apart: float, closing: float, play: float, stiffness: float, damping: float) -> float:
    """Force of a screw on its nut: a spring with a dashpot, N; with play a flank presses, and only where it touches.

    Args:
        apart: of the nut's place by the screw and its own from the middle of the play, m.
        closing: its rate, m/s.
        play: from flank to flank, m.
        stiffness: N/m.
        damping: N s/m.
    """
    if play <= 0.0:
        return stiffness * apart + damping * closing
    depth = abs(apart) - 0.5 * play
    if depth <= 0.0:
        return 0.0
    side = copysign(1.0, apart)
    return side * max(0.0, stiffness * depth + damping * side * closing)
