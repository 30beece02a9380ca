"""Physical quantities with the range in which each is plausible: any link from 5 cm to 50 m, from grams to tonnes.

What lies outside is a mistake of unit or of exponent, and is refused before any work is done with it.
"""

import re
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

from pydantic import FiniteFloat, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

_TOKEN = r"(?:N|m|m2|m3|m6|kg|s|s2|Pa|A|V|Hz|rad)"
_SUFFIX = re.compile(rf"_((?:per_)?{_TOKEN}(?:_(?:per_)?{_TOKEN})*)$")


def unit_of(name: str) -> str:
    """SI unit that the suffix of a key states, such as m³/s/A; empty where it has none."""
    found = _SUFFIX.search(name)
    if found is None:
        return ""
    words = found[1] if not found[1].startswith("per_") else f"1_{found[1]}"
    over, *under = words.split("_per_")
    parts = [over.replace("_", " "), *(step for part in under for step in part.split("_"))]
    return "/".join(parts).translate(str.maketrans("236", "²³⁶"))


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
    found = next(part for part in quantity.__metadata__ if isinstance(part, Plausible))
    assert isinstance(found, Plausible)
    return found


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
PeakOverPassive = Annotated[float, Plausible(0.01, inf)]
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
