"""What each added sensor buys: the bandwidth proved with it, each set of sensors grown from those that it contains."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from beamdesign import Prototype, certify
from beamdesign.controllers import SENSED, Sensed
from beamdesign.plant.members import family
from beamdesign.proofs.certificate import Asked, goal_claims
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.weight_search import ADDED_SENSORS_EFFORT, EFFORT, search_observer

SETS: tuple[tuple[Sensed, ...], ...] = (SENSED[:1], SENSED[:2], (SENSED[0], SENSED[2]), SENSED)
"""The displacement alone, with the inner tip's displacement, with the load pressure, with both."""


@dataclass(frozen=True)
class SensorRow:
    """What one set of sensors reaches.

    Attributes:
        sensors: what the controller reads.
        outer_end_mass_kg: range of the payload.
        bandwidth_Hz: proved, within all limits of the goal; 0 where nothing was.
        prototype: with the controller; None where nothing was proved.
        reason: why not, empty where it was.
    """

    sensors: tuple[Sensed, ...]
    outer_end_mass_kg: tuple[float, float]
    bandwidth_Hz: float
    prototype: Prototype | None = None
    reason: str = ""


def certified_row(prototype: Prototype) -> SensorRow:
    """The row of a prototype with an observer, whose limits and bandwidth are proved here.

    Raises:
        ValueError: for a prototype without an observer, or without a range of payloads.
    """
    law, masses = prototype.controller, prototype.payload.outer_end_mass_kg
    if law is None or masses is None:
        raise ValueError(f"{prototype.name} has no controller, or no payload range")
    limits = (Asked("peak_sensitivity", prototype.goal.peak_sensitivity), *goal_claims(prototype.goal))
    found = certify(prototype, *masses, claims=limits)
    if not found.holds or found.guaranteed is None:
        return SensorRow(law.senses, masses, 0.0, None, found.reason)
    return SensorRow(law.senses, masses, found.guaranteed.bandwidth_Hz, prototype)


def sensor_rows(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str | None = None,
    sets: Sequence[tuple[Sensed, ...]] = SETS,
    largest_inner_end_mass_kg: float = 6.0,
    told: Callable[[float, str], None] = lambda share, text: None,
    starts: Sequence[Prototype] = (),
) -> Iterator[SensorRow]:
    """Tune for each set of sensors in turn, from what the smaller sets reached.

    Args:
        prototype: the rig; its controller, where it is structured or an observer, is a start.
        outer_end_mass_kg: range of the guarantee.
        kind: of synthesis, to start from that as well; None for the starts alone.
        sets: of sensors, each after those that it contains.
        largest_inner_end_mass_kg: kg.
        told: the share done and what is being done, for each set anew.
        starts: prototypes whose controllers are further starts.
    """
    members = family(prototype, outer_end_mass_kg[1]).members
    reached: list[Proved] = []
    own = [(law, one.payload.inner_end_mass_kg) for one in (prototype, *starts) if (law := one.controller) is not None]
    for sensors in sets:
        grown = [
            (proved.controller, proved.inner_end_mass_kg)
            for proved in sorted(reached, key=lambda proved: -proved.bandwidth_Hz)
            if set(proved.controller.senses) <= set(sensors)
        ]
        first = [(one, inner) for one, inner in own if set(one.senses) == set(sensors)]
        inside, effort = (0.0, largest_inner_end_mass_kg), EFFORT if len(sensors) == 1 else ADDED_SENSORS_EFFORT
        task = Search(members, prototype.goal, outer_end_mass_kg, inside, tuple(sensors), effort=effort)
        found = search_observer(task, kind, [*grown[:2], *first], told)
        if found.proved is None:
            yield SensorRow(sensors, outer_end_mass_kg, 0.0, None, found.reason)
            continue
        reached.append(found.proved)
        payload = prototype.payload.but(
            outer_end_mass_kg=outer_end_mass_kg, inner_end_mass_kg=found.proved.inner_end_mass_kg
        )
        tuned = prototype.but(controller=found.proved.controller, payload=payload, guarantee=None)
        yield SensorRow(sensors, outer_end_mass_kg, found.proved.bandwidth_Hz, tuned)
