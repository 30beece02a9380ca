"""Up to which frequency the end of a link has the stiffness that it is told to have, and follows its command.

Both are inequalities quadratic in the end mass, decided as in `beamdesign.proof.performance`.
"""

from flint import fmpq, fmpq_poly

from beamdesign.loop import Tip
from beamdesign.polynomial import Affine
from beamdesign.proof.performance import Coefficients, kept_up_to_Hz, magnitude_slack

_S = fmpq_poly([0, 1])
_NONE = fmpq_poly([0])
_ROOT_OF_TWO = fmpq(14142, 10000)


def stiffness_slack(tip: Tip, stiffness: fmpq, share: fmpq) -> Coefficients:
    """(share k |n|)^2 - |p - k n|^2: not negative where F / x = p / n is within that share of the stiffness k."""
    error = Affine(tip.bare - stiffness * tip.moved, _S * _S * tip.moved)
    return magnitude_slack(share * stiffness, Affine(tip.moved, _NONE), error)


def guaranteed_stiffness_band(tip: Tip, stiffness: fmpq, share: fmpq, low: fmpq, high: fmpq) -> float:
    """Frequency (Hz) up to which |F/x / k - 1| is proved to be at most `share` with every end mass from low to high.

    Rounded down; 0 where it is not even at rest, infinite where it is at every frequency. It says nothing about
    stability.
    """
    return kept_up_to_Hz(stiffness_slack(tip, stiffness, share), low, high)


def guaranteed_command_band(tip: Tip, commanded: fmpq_poly, low: fmpq, high: fmpq) -> float:
    """Frequency (Hz) up to which the end follows its command with at least 1 / sqrt(2) of it, for every end mass.

    Args:
        tip: of the loop.
        commanded: numerator of x F / command over p, of static gain one; free of the mass.
        low: least end mass, kg.
        high: largest.
    """
    return kept_up_to_Hz(magnitude_slack(_ROOT_OF_TWO, Affine(commanded, _NONE), tip.over_mass), low, high)
