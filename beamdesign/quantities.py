"""Physical quantities with the range in which each is plausible: any link from 5 cm to 50 m, from grams to tonnes.

What lies outside is a mistake of unit or of exponent, and is refused before any work is done with it.

And their figures for people: SI values in the units an engineer reads, to a sensible number of digits, and in decibels.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from math import inf, isfinite, pi
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, FiniteFloat, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

if TYPE_CHECKING:
    from beamdesign.structure.section import Tube

_PLAIN = r"(?:kg_m2|N_m_s|N_m|N_s|A_s|Pa_s2|kg|Hz|mm|m[236]?|N|Pa|V|A|s2?|W|rad|deg|percent)"
_SUFFIX = re.compile(rf"(.+?)(?<!\d)_({_PLAIN}(?:_per_{_PLAIN})*|per_{_PLAIN})")  # at_1_Hz is a place


def parted(name: str) -> tuple[str, str]:
    """What a key is called, in words, and the SI unit that its suffix states, such as m3/s/A; empty without one."""
    found = _SUFFIX.fullmatch(name)
    stem, unit = found.groups() if found else (name, "")
    return stem.replace("_", " "), unit.replace("_per_", "/").replace("per_", "1/").replace("_", " ")


def unit_of(name: str) -> str:
    """SI unit that the suffix of a key states, such as m³/s/A; empty where it has none."""
    return parted(name)[1].translate(str.maketrans("236", "²³⁶"))


@dataclass(frozen=True)
class Plausible:
    """A range of figures, as an annotation of a field.

    Attributes:
        low: least plausible figure.
        high: largest one.
        or_zero: whether there may be none of it as well.
    """

    low: float
    high: float
    or_zero: bool = False

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high or (self.or_zero and value == 0)

    def __str__(self) -> str:
        most = f"to {self.high:g}" if self.high < inf else "up"
        return f"{self.low:g} {most}" + (" or 0" if self.or_zero else "")

    def refusal(self, value: Any, key: str) -> str:
        """What to say of a figure outside, with the unit that its key states."""
        return f"is {value}, outside the plausible range {self} {unit_of(key)}".rstrip()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check a figure after its type."""

        def check(value: float) -> float:
            if value not in self:
                raise PydanticCustomError("implausible", "outside {range}", {"range": self})
            return value

        return core_schema.no_info_after_validator_function(check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """State the range in a JSON schema."""
        most = {"maximum": self.high} if self.high < inf else {}
        return handler(schema) | {"minimum": 0.0 if self.or_zero else self.low} | most


def range_of(quantity: Any) -> Plausible:
    """The range of one of the quantities below."""
    return next(part for part in quantity.__metadata__ if isinstance(part, Plausible))


# Structure.
Mass = Annotated[FiniteFloat, Plausible(1e-6, 1e5)]
MassOrNone = Annotated[FiniteFloat, Plausible(0.0, 1e5)]
Length = Annotated[FiniteFloat, Plausible(1e-3, 100.0)]
Position = Annotated[FiniteFloat, Plausible(-100.0, 100.0)]
Width = Annotated[FiniteFloat, Plausible(1e-4, 2.0)]
DepthOverWidth = Annotated[FiniteFloat, Plausible(0.1, 10.0)]
Wall = Annotated[FiniteFloat, Plausible(1e-5, 1.0)]
Gap = Annotated[FiniteFloat, Plausible(1e-7, 1.0, or_zero=True)]
Stiffness = Annotated[FiniteFloat, Plausible(1.0, 1e10)]
Damping = Annotated[FiniteFloat, Plausible(1e-3, 1e9, or_zero=True)]
StructuralDamping = Annotated[FiniteFloat, Plausible(1e-6, 0.99, or_zero=True)]
YoungsModulus = Annotated[FiniteFloat, Plausible(1e8, 2e12)]
ShearModulus = Annotated[FiniteFloat, Plausible(1e7, 2e12)]
SolidDensity = Annotated[FiniteFloat, Plausible(50.0, 25e3)]
Strength = Annotated[FiniteFloat, Plausible(1e5, 1e10)]
PolarInertia = Annotated[FiniteFloat, Plausible(1e-9, 1e7, or_zero=True)]
TorsionalStiffness = Annotated[FiniteFloat, Plausible(1e-3, 1e12)]
Force = Annotated[FiniteFloat, Plausible(1e-6, 1e7)]
ForceOrNone = Annotated[FiniteFloat, Plausible(1e-6, 1e7, or_zero=True)]
SignedForce = Annotated[FiniteFloat, Plausible(-1e7, 1e7)]
ComplianceLimit = Annotated[FiniteFloat, Plausible(1e-13, 1.0)]
Slenderness = Annotated[FiniteFloat, Plausible(2.0, 1e3)]
Rounding = Annotated[FiniteFloat, Plausible(1e-12, 1e-3)]
Excursion = Annotated[FiniteFloat, Plausible(1e-9, 1.0)]

# Hydraulics.
PistonArea = Annotated[FiniteFloat, Plausible(1e-7, 1.0)]
Stroke = Annotated[FiniteFloat, Plausible(1e-4, 10.0)]
Bore = Annotated[FiniteFloat, Plausible(5e-4, 1.0)]
RodDiameter = Annotated[FiniteFloat, Plausible(1e-4, 1.0, or_zero=True)]
StartPosition = Annotated[FiniteFloat, Plausible(0.0, 10.0)]
SupplyPressure = Annotated[FiniteFloat, Plausible(1e5, 1e8)]
TankPressure = Annotated[FiniteFloat, Plausible(100.0, 1e7, or_zero=True)]
BulkModulus = Annotated[FiniteFloat, Plausible(1e7, 1e10)]
Volume = Annotated[FiniteFloat, Plausible(1e-9, 0.1)]
FlowRate = Annotated[FiniteFloat, Plausible(1e-8, 1.0)]
FlowPerCurrent = Annotated[FiniteFloat, Plausible(1e-6, 5.0)]
FlowPerVolt = Annotated[FiniteFloat, Plausible(1e-9, 0.1)]
Leakage = Annotated[FiniteFloat, Plausible(1e-18, 1e-8, or_zero=True)]
LineLoss = Annotated[FiniteFloat, Plausible(1e3, 1e20, or_zero=True)]
ComponentFrequency = Annotated[FiniteFloat, Plausible(0.1, 1e5)]
SpoolDamping = Annotated[FiniteFloat, Plausible(0.01, 10.0)]
EdgeRatio = Annotated[FiniteFloat, Plausible(0.01, 2.0)]

# Electric drives.
Lead = Annotated[FiniteFloat, Plausible(1e-5, 1.0)]
TorqueConstant = Annotated[FiniteFloat, Plausible(1e-4, 1e3)]
RotorInertia = Annotated[FiniteFloat, Plausible(1e-9, 100.0)]
RotorFriction = Annotated[FiniteFloat, Plausible(1e-9, 1e3, or_zero=True)]
SpeedFeedback = Annotated[FiniteFloat, Plausible(1e-9, 1e4, or_zero=True)]
MotorCurrent = Annotated[FiniteFloat, Plausible(1e-3, 1e4)]
DriveGain = Annotated[FiniteFloat, Plausible(1e-4, 1e3)]
RotorSpeed = Annotated[FiniteFloat, Plausible(0.01, 1e5)]

# Signals and laws.
Current = Annotated[FiniteFloat, Plausible(1e-5, 10.0)]
SensorGain = Annotated[FiniteFloat, Plausible(0.1, 1e8)]
Noise = Annotated[FiniteFloat, Plausible(1e-12, 100.0, or_zero=True)]
Resolution = Annotated[FiniteFloat, Plausible(1e-12, 0.1, or_zero=True)]
SignedVoltage = Annotated[FiniteFloat, Plausible(-1e3, 1e3)]
Voltage = Annotated[FiniteFloat, Plausible(1e-6, 1e3)]
Frequency = Annotated[FiniteFloat, Plausible(1e-4, 1e5)]
SectionDamping = Annotated[FiniteFloat, Plausible(1e-4, 100.0)]
LawGain = Annotated[FiniteFloat, Plausible(1e-9, 1e4)]
Duration = Annotated[FiniteFloat, Plausible(1e-6, 600.0)]
DurationOrNone = Annotated[FiniteFloat, Plausible(1e-6, 600.0, or_zero=True)]
SamplePeriod = Annotated[FiniteFloat, Plausible(1e-5, 0.01)]
Update = Annotated[FiniteFloat, Plausible(1e-5, 1.0)]
Window = Annotated[FiniteFloat, Plausible(1e-4, 2.0)]
EstimatorNoise = Annotated[FiniteFloat, Plausible(1e-9, 10.0)]

# Ratios.
RelativeStd = Annotated[FiniteFloat, Plausible(1e-12, 1.0, or_zero=True)]
PositiveStd = Annotated[FiniteFloat, Plausible(1e-6, 1.0)]
Unexplained = Annotated[FiniteFloat, Plausible(1e-6, 0.99, or_zero=True)]
Level = Annotated[FiniteFloat, Plausible(-100.0, 100.0)]
PeakSensitivity = Annotated[FiniteFloat, Plausible(1.00001, 1e3)]
PeakOverPassive = Annotated[float, BeforeValidator(lambda limit: inf if limit is None else limit), Plausible(0.01, inf)]
"""No limit is infinite; JSON, which has no such number, states none."""
LoopGain = Annotated[FiniteFloat, Plausible(1e-6, 1e6)]
SafetyFactor = Annotated[FiniteFloat, Plausible(1.0, 1e3)]
MatrixEntry = Annotated[FiniteFloat, Plausible(-1e30, 1e30)]

# What options ask for.
DecayRate = Annotated[FiniteFloat, Plausible(1e-4, 1e5)]
GainFactor = Annotated[FiniteFloat, Plausible(1e-3, 1e3)]
Sigmas = Annotated[FiniteFloat, Plausible(1e-3, 20.0, or_zero=True)]
Minutes = Annotated[FiniteFloat, Plausible(0.0, 1e5)]
Delay = Annotated[FiniteFloat, Plausible(1e-7, 1.0, or_zero=True)]
MassRate = Annotated[FiniteFloat, Plausible(1e-6, 1e6)]
SamplingRate = Annotated[FiniteFloat, Plausible(1.0, 1e7)]
FullScale = Annotated[FiniteFloat, Plausible(1e-3, 1e3)]
LargestCurrent = Annotated[FiniteFloat, Plausible(1e-7, 100.0)]
Bandwidth = Annotated[FiniteFloat, Plausible(1e-3, 500.0)]
Share = Annotated[FiniteFloat, Plausible(1e-6, 1.0)]
Distance = Annotated[FiniteFloat, Plausible(0.0, 100.0)]
TimeLimit = Annotated[float, Plausible(0.0, inf)]
WallStiffness = Annotated[FiniteFloat, Plausible(1e-3, 1e12, or_zero=True)]
Millimetres = Annotated[FiniteFloat, Plausible(1e-6, 1e3)]


_UNITS = {
    "m": ("mm", 1e3),
    "m2": ("mm²", 1e6),
    "Pa": ("MPa", 1e-6),
    "N/m": ("kN/m", 1e-3),
    "m/N": ("nm/N", 1e9),
    "kg/m3": ("kg/m³", 1.0),
    "A/V": ("mA/V", 1e3),
    "A": ("mA", 1e3),
    "V/m": ("V/mm", 1e-3),
    "m3/s": ("l/min", 6e4),
    "m3/s/A": ("cm³/s/mA", 1e3),
    "m3/s/Pa": ("cm³/s/MPa", 1e12),
    "N m s/rad": ("mN m s/rad", 1e3),
    "kg m2": ("kg cm²", 1e4),
    "rad/s": ("rpm", 30 / pi),
    "1": ("", 1.0),
} | {unit: (unit, 1.0) for unit in ("N", "N m", "N s/m", "kg", "Hz", "V", "N m/A", "A s/rad", "W")}
"""By SI unit: the one in which it is read, and how many of these it is."""

_LARGE = {"A": 0.5, "A/V": 1.0}
"""From where on the SI unit itself is read."""


def decimal(value: float, digits: int = 4, rounding: str = ROUND_HALF_EVEN) -> str:
    """A number to so many significant digits, without an exponent unless it is very small or large.

    Digits before the decimal point are never rounded away; zeros at the end are left out.

    Args:
        value: the number.
        digits: significant digits.
        rounding: a rounding mode of the `decimal` module; what is guaranteed is to be rounded to the safe side.
    """
    if not isfinite(value):
        return "∞" if value > 0 else "-∞" if value < 0 else "undefined"
    if value == 0:
        return "0"
    written = Decimal(repr(float(value)))
    magnitude = written.adjusted()
    if not -5 <= magnitude <= 8:
        return f"{written.quantize(Decimal(1).scaleb(magnitude - digits + 1), rounding=rounding):.{digits - 1}e}"
    step = Decimal(1).scaleb(min(magnitude - digits + 1, 0))
    text = f"{written.quantize(step, rounding=rounding):f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def quantity(value: float, unit: str, digits: int = 4, rounding: str = ROUND_HALF_EVEN) -> str:
    """An SI value as text in the unit it is read in, such as "57.1 nm/N" for 5.71e-8 m/N.

    Args:
        value: in SI.
        unit: its SI unit as the package writes units, such as "m3/s/A"; "1" for a pure number.
        digits: significant digits.
        rounding: see `decimal`.
    """
    shown, factor = read_in(value, unit)
    # In decimals 6e-8 times 1e9 is 60, whichever way is rounded.
    exact = Decimal(repr(float(value))) * Decimal(repr(factor))
    return f"{decimal(float(exact), digits, rounding)} {shown}".rstrip()


def read_in(value: float, unit: str) -> tuple[str, float]:
    """The unit in which an SI value is read, and how many of it the SI unit is: itself where no other is known."""
    return (unit, 1.0) if unit in _LARGE and _LARGE[unit] <= abs(value) < inf else _UNITS.get(unit, (unit, 1.0))


def at_least(value: float, unit: str, digits: int = 4) -> str:
    """A quantity rounded down: what is guaranteed to be at least this."""
    return quantity(value, unit, digits, ROUND_FLOOR)


def at_most(value: float, unit: str, digits: int = 4) -> str:
    """A quantity rounded up: what is guaranteed to be at most this."""
    return quantity(value, unit, digits, ROUND_CEILING)


def stated_bandwidth(value: float) -> str:
    """A guaranteed bandwidth, Hz, with all digits to which it is stated anywhere: never more than was proved."""
    return at_least(value, "Hz", 7)


def compliance_kept(limit_m_per_N: float, bandwidth_Hz: float) -> str:
    """How far a force moves the tip, by the bandwidth (Hz) that is guaranteed with a limit; none is zero."""
    if bandwidth_Hz <= 0:
        return f"gives way by more than {at_least(limit_m_per_N, 'm/N', 7)} even to a steady force"
    return f"gives way by no more than {at_most(limit_m_per_N, 'm/N', 7)} up to {stated_bandwidth(bandwidth_Hz)}"


def stated_peak(value: float) -> str:
    """A guaranteed bound of a magnitude without a unit, likewise: never less than was proved."""
    return at_most(value, "1", 7)


def stated_range(ends: tuple[float, float], digits: int = 7, joined: str = " to ") -> str:
    """A range of which all is proved, its ends rounded inwards; one that so few digits do not tell, with all."""
    low, high = decimal(ends[0], digits, ROUND_CEILING), decimal(ends[1], digits, ROUND_FLOOR)
    return f"{low}{joined}{high}" if ends[1] == inf or float(low) <= float(high) else f"{ends[0]!r}{joined}{ends[1]!r}"


def per_cent(share: float) -> str:
    """A share as a percentage to a tenth, never rounded to 100 % from below or above."""
    if not isfinite(share):
        return "∞"
    text = f"{100 * share:.1f}"
    if text == "100.0" and abs(share - 1) > 1e-9:
        return "just under 100 %" if share < 1 else "just over 100 %"
    return f"{text} %"


def mass_range_text(bounds: tuple[float, float]) -> str:
    """A range of masses with all its digits, such as "0 to 6.8 kg"."""
    return f"{bounds[0]:.15g} to {bounds[1]:.15g} kg"


def masses_text(bounds: tuple[float, float]) -> str:
    """The same, or the one mass that it holds."""
    return f"{bounds[0]:.15g} kg" if bounds[0] == bounds[1] else mass_range_text(bounds)


def guaranteed_rows(
    found: Any, bounds: tuple[float, float], further: Sequence[tuple[str, str]] = ()
) -> list[tuple[str, str]]:
    """What is proved for every mass of a range, by name: bandwidth, peak sensitivity, and what else there is.

    Args:
        found: with `bandwidth_Hz`, `peak_sensitivity` and `sigmas`.
        bounds: least and largest outer end mass, kg.
        further: rows of other figures.
    """
    return [
        ("guaranteed bandwidth", stated_bandwidth(found.bandwidth_Hz)),
        ("guaranteed peak sensitivity", stated_peak(found.peak_sensitivity)),
        *further,
        ("for every outer end mass", mass_range_text(bounds)),
        ("of", rigs_in_words(found.sigmas)),
    ]


def further_rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Lower gains, figures for exactly the stated rig, and which tolerances to tighten first.

    Args:
        found: as of `beamdesign.synthesis.law_design.Proved.guaranteed`.
    """
    lower, nominal = found["lower_gains"], found["nominal"]
    rows = []
    if isfinite(ratio := found["peak_over_passive"]):
        most, over = (decimal(value, 4, ROUND_CEILING) for value in (found["peak_compliance_m_per_N"], ratio))
        words = f"at most {most} m/N, {over} times that with the servo off"
        rows.append(("largest compliance at any frequency", words))
    rows += [("at lower gains", "stable at every one" if lower is True else start_up(lower))]
    if found["comes_to_rest"]:
        frozen = f", with {' and '.join(names)} frozen" if (names := found.get("at_rest_with_frozen")) else ""
        rows += [("while the law's current saturates", f"comes to rest from every state{frozen}")]
    if found["rigs"] != "nominal":
        figures = stated_bandwidth(nominal["bandwidth_Hz"]), stated_peak(nominal["peak_sensitivity"])
        rows += [("of exactly these figures", f"{figures[0]}, peak sensitivity {figures[1]}")]
        first = ", ".join(one["parameter"] for one in found["tightest"][:3])
        rows += [("tolerances to tighten first", first)] if first else []
    return rows


def start_up(forbidden: Sequence[tuple[float, float]]) -> str:
    """What lower gains do to a loop that is not stable at all of them, and how to switch it on, in words."""
    stretches = ", ".join(f"{100 * low:.3g} to {100 * high:.3g} %" for low, high in forbidden)
    return (
        f"UNSTABLE with about {stretches} of its gain, of exactly these figures and on a grid, other rigs perhaps with"
        " more: bring the supply up with the current off, then switch the whole gain on at once; a current that"
        " saturates may set it oscillating for good"
        if forbidden
        else "stable at every one that was looked at, which nothing proves"
    )


def rigs_in_words(sigmas: float) -> str:
    """Which rigs something holds for: those of a box of so many standard deviations, of zero the stated one."""
    every = f"every rig within {sigmas:.15g} standard deviations of each figure that varies"
    return every if sigmas else "exactly these figures"


def tube_text(tube: "Tube") -> str:
    """A tube by its outside sizes, first that across the load, wall and corners, to a hundredth of a millimetre."""
    sizes = [tube.width_m, *([] if tube.shape == "round" else [tube.depth_m]), tube.wall_m]
    *words, radius = (f"{1e3 * size:.2f}".rstrip("0").rstrip(".") for size in (*sizes, tube.corner_radius_m))
    if tube.shape == "round":
        return f"Ø {' × '.join(words)} mm"
    return f"{' × '.join(words)} mm" + (f", corners R {radius} mm" if tube.corner_radius_m else "")


INCH_M = 0.0254
POUND_FORCE_N = 4.4482216152605  # 0.45359237 kg at 9.80665 m/s2, both exact by definition
INCH_PER_POUND_FORCE = INCH_M / POUND_FORCE_N
"""1 in/lbf in m/N."""


def decibels(compliance_m_per_N: Any) -> Any:
    """Level in dB re 1 in/lbf of a compliance magnitude in m/N; -inf for zero."""
    import numpy as np  # records, which have quantities, are read without it

    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.abs(compliance_m_per_N) / INCH_PER_POUND_FORCE)


def from_decibels(level_dB: Any) -> Any:
    """Compliance magnitude in m/N of a level in dB re 1 in/lbf."""
    import numpy as np

    return INCH_PER_POUND_FORCE * 10.0 ** (np.asarray(level_dB) / 20)
