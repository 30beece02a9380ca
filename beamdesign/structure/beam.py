"""The cantilever: tip stiffness, effective mass, natural frequencies, and what deflection leaves of a clearance.

Equation numbers are those of Zalucky and Hardt, "Active Control of Robot Structure Deflections", J. Dyn. Sys., Meas.,
Control 106 (1984). Lengths are free lengths, from the clamp to the tip: what is clamped in the base neither bends nor
moves, so it adds nothing to compliance or to effective mass. The closed forms work on floats, numpy arrays and CasADi
symbols.
"""

from math import pi
from typing import Literal

from beamdesign.structure.section import Quantity

MODE_MASS_FRACTION = 0.236
"""Share of a uniform beam's mass that moves with its tip, equations (2) and (5).

It is 33/140 rounded: the kinetic energy of the static tip-load shape (Rayleigh), in which Y enters squared. It makes
(2) too high by 1.4 % with no end mass, and better the heavier the end mass is.
"""

STATIC_MASS_FRACTION = 0.375
"""Equation (6): 3/8, equation (1) with the static tip-load shape, in which Y enters once (force, not energy)."""


def static_shape(position: Quantity) -> Quantity:
    """Deflection of a cantilever under a tip force relative to its tip's, Y(x) / Y_end, at x / L in 0..1."""
    return position**2 * (3 - position) / 2


def tip_stiffness(flexural_rigidity: Quantity, free_length: Quantity) -> Quantity:
    """Force per deflection at the tip, K = 3 E I / L^3, equation (3).

    Args:
        flexural_rigidity: E I, N m2.
        free_length: L from the clamp to the tip, m.

    Returns:
        Stiffness, N/m.
    """
    return 3 * flexural_rigidity / free_length**3


def effective_mass(
    mass_per_length: Quantity,
    free_length: Quantity,
    end_mass: Quantity = 0.0,
    shape: Literal["mode", "static"] = "mode",
) -> Quantity:
    """Mass that, lumped at the tip, stands for a uniform beam and what is fixed to its end.

    Args:
        mass_per_length: m, kg/m.
        free_length: L from the clamp to the tip, m.
        end_mass: M_end, kg.
        shape: "mode" for equation (5), right at the first natural frequency and the one the paper uses; "static" for
            equation (6), right well below it.

    Returns:
        M_eff, kg.
    """
    fraction = MODE_MASS_FRACTION if shape == "mode" else STATIC_MASS_FRACTION
    return end_mass + fraction * mass_per_length * free_length


def first_frequency(
    flexural_rigidity: Quantity, mass_per_length: Quantity, free_length: Quantity, end_mass: Quantity = 0.0
) -> Quantity:
    """First natural frequency by equation (2), without the minus sign that is printed before it.

    Args:
        flexural_rigidity: E I, N m2.
        mass_per_length: m, kg/m.
        free_length: L, m.
        end_mass: M_end, kg.

    Returns:
        f_n, Hz.
    """
    stiffness = tip_stiffness(flexural_rigidity, free_length)
    return (stiffness / effective_mass(mass_per_length, free_length, end_mass)) ** 0.5 / (2 * pi)


def natural_frequencies(
    flexural_rigidity: float, mass_per_length: float, free_length: float, end_mass: float = 0.0, count: int = 3
) -> list[float]:
    """Natural frequencies of the uniform cantilever with a point mass at its tip, without lumping.

    The wave numbers k solve 1 + cos kL cosh kL + mu kL (cos kL sinh kL - sin kL cosh kL) = 0 with mu = M_end / (m L)
    (Euler and Bernoulli's beam; e.g. R. D. Blevins, Formulas for Natural Frequency and Mode Shape, 1979, chapter 8).

    Args:
        flexural_rigidity: E I, N m2.
        mass_per_length: m, kg/m.
        free_length: L, m.
        end_mass: M_end, kg, without rotary inertia.
        count: how many, from the lowest.

    Returns:
        Frequencies, Hz, ascending.
    """
    from math import cos, exp, sin

    from scipy.optimize import brentq

    ratio = end_mass / (mass_per_length * free_length)

    def characteristic(wave: float) -> float:
        # Divided by cosh, so that high modes do not overflow.
        decay = exp(-2 * wave)
        hyperbolic_tangent = (1 - decay) / (1 + decay)
        secant = 2 * exp(-wave) / (1 + decay)
        return secant + cos(wave) + ratio * wave * (cos(wave) * hyperbolic_tangent - sin(wave))

    # A tip mass moves the n-th root from its free-tip value down towards the pinned-tip one, and the two families
    # interlace: root n lies between (n - 1) pi and n pi. The first tends to zero with a large mass.
    roots = [brentq(characteristic, max(n * pi, 1e-9), (n + 1) * pi, xtol=1e-12) for n in range(count)]
    scale = (flexural_rigidity / mass_per_length) ** 0.5 / (2 * pi * free_length**2)
    return [float(root**2 * scale) for root in roots]


def clearance_under_load(clearance: Quantity, tip_force: Quantity, inner_stiffness: Quantity) -> Quantity:
    """Gap left when the servo holds the outer beam straight and the inner one bends under the whole load.

    Args:
        clearance: gap per side at assembly, m.
        tip_force: F, N.
        inner_stiffness: K_f, N/m.

    Returns:
        clearance - F / K_f, m; negative where the beams touch. The tip is where the deflection is largest.
    """
    return clearance - tip_force / inner_stiffness
