"""The lag, which gives a loop its gain at low frequencies."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.cascade import Break, Cascade, Factor
from beamdesign.controllers.protocol import Controller, refuse


class Lag(Cascade):
    """C(s) = (1 + s / zero) / (1 + s / pole)."""

    checked: ClassVar[bool] = True
    kind: Annotated[Literal["lag"], Field(description="which law, with its own figures")] = "lag"
    pole_Hz: Annotated[q.Frequency, Field(description="lower break frequency")]
    zero_Hz: Annotated[q.Frequency, Field(description="upper break frequency")]

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Its breaks."""
        return (Break(self.pole_Hz, self.zero_Hz),)

    @classmethod
    def seeds(cls) -> tuple["Lag", ...]:
        """See `Controller`."""
        return (cls(gain_A_per_V=3e-3, pole_Hz=1.0, zero_Hz=30.0),)

    def grown(self) -> tuple[Controller, ...]:
        """A section behind it."""
        from beamdesign.controllers.structured import grown

        return grown(self)


def as_lag(controller: Controller) -> Lag:
    """A lag as it is, and a proportional law as a lag whose breaks coincide.

    Raises:
        InputError: for any other.
    """
    refuse(controller, "lag", "a lag's place", "controller")
    lag = controller.lag or Break(1.0, 1.0)
    return Lag(gain_A_per_V=controller.gain_A_per_V, pole_Hz=lag.pole_Hz, zero_Hz=lag.zero_Hz)
