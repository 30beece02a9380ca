"""What to make and to buy: tubes and their stock sizes; what cylinder, valve, supply and sensor must give."""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from beamdesign.build.tolerances import Performance, performance_of_all, why_no_box
from beamdesign.controllers import Observer
from beamdesign.loop import loop
from beamdesign.plant.actuators import MARGIN, Row
from beamdesign.plant.assembly import effect_parameters_of, pace
from beamdesign.plant.effects import library
from beamdesign.plant.members import own_sag_m, weight_N
from beamdesign.polynomial import at_points, exact
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.certifying import stability_over
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.tolerance_box import box_with_effects
from beamdesign.prototype import Beam, InStage, Prototype
from beamdesign.quantities import tube_text
from beamdesign.result import picked
from beamdesign.structure import lumped
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.section import Tube, stock_tubes
from beamdesign.structure.shapes import gaps
from beamdesign.synthesis.operating_limits import SHOWN_HZ, Envelope, envelope, needs_to_carry


@dataclass(frozen=True)
class TubeToMake:
    """One tube as the workshop sees it; lengths in m, masses in kg."""

    name: str
    size: str
    nearest_stock: str
    length_m: float
    free_length_m: float
    clamped_m: float
    material: str
    tube_mass_kg: float
    end_mass_kg: float


class HeldLoad(NamedTuple):
    """One load case: which beam bends, how far its tip moves, what is left of the gap; m."""

    case: str
    deflection_m: float
    gap_left_m: float


@dataclass(frozen=True)
class StockChoice:
    """One tube.

    Attributes:
        made: what to cut and clamp.
        stock: nearest stock tube that is no less stiff; where there is none, the stiffest.
        same: whether the tube is that stock size.
        fits: whether the gap between the tubes stays positive with it.
        stiffness_N_per_m: of the tip as specified, and with the stock tube by its geometry.
        effective_mass_kg: likewise.
        tube_mass_kg: likewise.
        gap_m: least play per side, likewise.
        stable: whether the loop with this tube exchanged is proved stable over the range; None where it is the same
            or does not fit.
        bandwidth_Hz, peak_sensitivity: proved with it; None where not stable.
    """

    made: TubeToMake
    stock: Tube
    same: bool
    fits: bool
    stiffness_N_per_m: tuple[float, float]
    effective_mass_kg: tuple[float, float]
    tube_mass_kg: tuple[float, float]
    gap_m: tuple[float, float]
    stable: bool | None
    bandwidth_Hz: float | None
    peak_sensitivity: float | None

    @property
    def softer(self) -> bool:
        """Whether the stock tube is less stiff than the beam as specified."""
        return not self.same and self.stiffness_N_per_m[1] < self.stiffness_N_per_m[0]


def nearest_stock_tube(made: Tube) -> Tube:
    """The stock tube of at least this wall and bending stiffness with the least area, or the stiffest of the list.

    It is of the same shape and, where there are such, ratio of sides.
    """
    stock = stock_tubes(made.shape, made.depth_over_width) or stock_tubes(made.shape)
    wall, needed = made.wall_m * (1 - 1e-9), made.second_moment * (1 - 1e-9)
    enough = [tube for tube in stock if tube.wall_m >= wall and tube.second_moment >= needed]
    if enough:
        return min(enough, key=lambda tube: float(tube.area))
    return max(stock, key=lambda tube: float(tube.second_moment))


def held_loads(prototype: Prototype, tip_force_N: float) -> tuple[HeldLoad, ...]:
    """Static deflection and remaining gap with the servo on (inner beam bends) and off (outer beam bends)."""
    gap, found = _gaps(prototype.outer_beam, prototype.inner_beam)[0], []
    for words, record in (
        ("servo on: the inner beam bends, the outer one is held straight", prototype.inner_beam),
        ("servo off: the outer beam bends, the inner one is unloaded", prototype.outer_beam),
    ):
        stiffness = lumped_beam(record).stiffness
        left = float(lumped.clearance_under_load(gap, tip_force_N, stiffness))
        found.append(HeldLoad(words, tip_force_N / stiffness, left))
    return tuple(found)


def stock_choices(prototype: Prototype, masses_kg: tuple[float, float]) -> tuple[StockChoice, ...] | None:
    """Both tubes, or None where a beam has no geometry.

    With a stock tube its lumped figures are those of its geometry, whatever was measured on the tube it replaces.
    """
    if not (prototype.outer_beam.geometry and prototype.inner_beam.geometry):
        return None
    return tuple(_choice(prototype, name, masses_kg) for name in ("outer", "inner"))


def _choice(prototype: Prototype, name: str, masses_kg: tuple[float, float]) -> StockChoice:
    record = getattr(prototype, f"{name}_beam")
    stock = nearest_stock_tube(record.but(corner_radius_m=0.0).tube)
    pairs = ((getattr(stock, key), getattr(record.tube, key)) for key in ("width_m", "depth_m", "wall_m"))
    same = all(abs(own - asked) < 1e-9 for own, asked in pairs)
    other = record.but(**stock.sizes, corner_radius_m=0.0, stiffness_N_per_m=None, effective_mass_kg=None)
    beams = {"outer": prototype.outer_beam, "inner": prototype.inner_beam}
    before, after = (float(min(_gaps(**pair))) for pair in (beams, beams | {name: other}))
    length = record.length_m if record.length_m is not None else record.free_length_m
    density = record.material.density_kg_per_m3
    tube_mass_kg, exchanged_kg = (float(length * one.tube.mass_per_length(density)) for one in (record, other))
    made = TubeToMake(
        name=name,
        size=tube_text(record.tube),
        nearest_stock="is a stock size" if same else tube_text(stock),
        length_m=length,
        free_length_m=record.free_length_m,
        clamped_m=length - record.free_length_m,
        material=record.material.name,
        tube_mass_kg=tube_mass_kg,
        end_mass_kg=record.end_mass_kg,
    )
    stable: bool | None = None
    reached: Performance = (None, None)
    if not same and after > 0:
        reached = performance_of_all(prototype.but(**{f"{name}_beam": other}, guarantee=None).stages(masses_kg))
        stable = reached[0] is not None
    found, exchanged = lumped_beam(record), lumped_beam(other)
    return StockChoice(
        made, stock, same, after > 0, (found.stiffness, exchanged.stiffness), (found.mass, exchanged.mass),
        (tube_mass_kg, exchanged_kg), (before, after), stable, *reached,
    )  # fmt: skip


def _gaps(outer: Beam, inner: Beam) -> tuple[float, ...]:
    """Play per side at assembly, m: along the load, and across where it is another."""
    found = gaps(outer, inner)
    assert found is not None  # stock is chosen where both have a geometry
    return found


@dataclass(frozen=True)
class Ratings:
    """Ratings for a force on the tip that is put on and taken off up to a bandwidth, beside the weight of the link.

    Attributes:
        load_N: the force.
        weight_N: of the largest payload and of the outer beam, at the tip.
        up_to_Hz: bandwidth.
        rows: of the actuator, margins included, its stroke from end to end among them.
        envelope: largest amplitude over frequency that the prototype's own ratings allow beside the weight, with the
            largest payload.
    """

    load_N: float
    weight_N: float
    up_to_Hz: float
    rows: tuple[Row, ...]
    envelope: Envelope

    @property
    def needed(self) -> dict[str, float]:
        """What is computed, by its key."""
        return {row.key: row.needed for row in self.rows if row.key}

    @property
    def stated(self) -> dict[str, float]:
        """What the prototype states of that."""
        return {row.key: row.stated for row in self.rows if row.key and row.stated is not None}

    def to_dict(self) -> dict[str, Any]:
        """As a JSON file has it."""
        return picked(self, "load_N weight_N up_to_Hz envelope") | self.needed | {"given": self.stated}


def ratings(prototype: Prototype, masses_kg: tuple[float, float], load_N: float, up_to_Hz: float) -> Ratings:
    """Ratings over both ends and the middle of a payload range, of each law its own; the largest of each.

    Args:
        prototype: with a controller whose loop is stable at these masses.
        masses_kg: range of outer end mass.
        load_N: force on the tip that is put on and taken off, beside the weight.
        up_to_Hz: highest frequency of it.
    """
    need, actuator = needs_to_carry(prototype, masses_kg, load_N, up_to_Hz), prototype.actuator
    weight = weight_N(prototype, masses_kg[1])
    at_rest = (load_N + weight) / lumped_beam(prototype.inner_beam).stiffness + own_sag_m(prototype)
    rows = (
        *actuator.rows(prototype, need, load_N + weight),
        Row("stroke to either side that holds load and weight, at least", at_rest, None, "m", "rest_stroke_m"),
        Row(f"stroke from end to end, × {MARGIN:g}", 2 * MARGIN * need["stroke_m"], actuator.stroke_m, "m", "stroke_m"),
    )
    heaviest = prototype.stages(masses_kg)[-1].prototype
    left = envelope(heaviest, masses_kg[1], weight, pace(lumped.figures(heaviest)) * SHOWN_HZ)
    return Ratings(load_N, weight, up_to_Hz, rows, left)


KEPT = 0.05
"""How much of the guaranteed bandwidth, and by how much the peak sensitivity, the sensor's lag may cost."""
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 1e5
_HALVINGS = 9
_BUDGET = 2000


@dataclass(frozen=True)
class SensorNeed:
    """Requirements on the sensor.

    Attributes:
        stable_from_Hz: first-order break of the sensor from which the loop is proved stable at every outer end mass,
            for every break from here to `fastest_Hz`; None where none was proved.
        fastest_Hz: largest break that was asked about.
        performs_from_Hz: break at which bandwidth and peak sensitivity are proved within `KEPT` of what they are with
            an ideal sensor; None where none was.
        bandwidth_Hz, peak_sensitivity: proved at that break.
        motion_m: tip motion that the goal allows under the reference load.
        share: of it that noise may cause.
        resolution_m: least step that the sensor must tell: the loop follows it where it is slow.
        noise_bandwidth_Hz: of the loop from sensor noise to tip motion, the largest over the masses looked at.
        noise_density_m_per_rtHz: one-sided density of sensor noise, white, that moves the tip by that share, RMS.
        noise_m: RMS of that noise in the band of a first-order sensor that performs.
        given_resolution_m, given_noise_m: what the prototype states; None where it does not.
    """

    stable_from_Hz: float | None
    fastest_Hz: float
    performs_from_Hz: float | None
    bandwidth_Hz: float | None
    peak_sensitivity: float | None
    motion_m: float
    share: float
    resolution_m: float
    noise_bandwidth_Hz: float
    noise_density_m_per_rtHz: float
    noise_m: float | None
    given_resolution_m: float | None
    given_noise_m: float | None


def lagging(prototype: Prototype, break_Hz: float) -> Prototype:
    """The prototype of one law with a first-order lag in its sensor, beside what it has already.

    Where a filter and a lag stand there, that lag is put into the law that hears it, which leaves the loop as it is.
    """
    if prototype.sensor.filter_Hz is None:
        return prototype.but(sensor=prototype.sensor.but(filter_Hz=break_Hz), guarantee=None)
    law = prototype.controller
    if law is not None and "sensor_lag" in prototype.effects:
        law = Observer.behind_lag(law, effect_parameters_of(prototype)["sensor_lag"]["break_Hz"])
    effects = {**prototype.effects, "sensor_lag": {"break_Hz": break_Hz}}
    return prototype.but(controller=law, effects=effects, guarantee=None)


def _lagging_stages(prototype: Prototype, masses_kg: tuple[float, float], break_Hz: float) -> list[InStage]:
    return [one._replace(prototype=lagging(one.prototype, break_Hz)) for one in prototype.stages(masses_kg)]


def sensor_need(prototype: Prototype, masses_kg: tuple[float, float], load_N: float, share: float) -> SensorNeed:
    """Requirements on the sensor of a prototype whose loop is proved stable over the range.

    Args:
        prototype: with a controller.
        masses_kg: range of outer end mass.
        load_N: reference load, for the motion that the goal allows.
        share: of that motion that noise may cause.
    """
    stages, breaks = prototype.stages(masses_kg), _breaks_Hz(prototype)
    try:
        _lagging_stages(prototype, masses_kg, breaks[1])
    except ValueError:  # a law of the largest order has no room for a lag: nothing is proved with one
        nominal: Performance = (None, None)
    else:
        nominal = performance_of_all(stages)

    def reaches(break_Hz: float) -> Performance:
        return performance_of_all(_lagging_stages(prototype, masses_kg, break_Hz))

    def stands(break_Hz: float) -> bool:
        lagged = _lagging_stages(prototype, masses_kg, break_Hz)
        return all(stability_over(stage.prototype, *stage.outer_end_mass_kg).stable for stage in lagged)

    stable = performs = None
    if nominal[0] is not None:
        if not why_no_box(stages[0].prototype):
            stable = _least(stands, breaks)
        while stable is not None and not _proved_above(prototype, masses_kg, stable):
            stable = None if 1.1 * stable >= breaks[1] else _of_four_digits(1.1 * stable)
        # never slower than it is stable from on: below that, what one break keeps a faster one may lose
        performs = _least(lambda f: _kept(reaches(f), nominal), (stable or breaks[0], breaks[1]))
    reached = (None, None) if performs is None else reaches(performs)
    motion = prototype.goal.compliance_m_per_N * load_N
    band = max(noise_bandwidth_Hz(stage.prototype, mass) for stage in stages for mass in stage.looked_at_kg)
    density = share * motion / sqrt(band)
    sensor = prototype.sensor
    return SensorNeed(
        stable, breaks[1], performs, *reached, motion, share, share * motion, band, density,
        None if performs is None else density * sqrt(pi / 2 * performs), sensor.resolution_m,
        None if sensor.noise_V is None else sensor.noise_V / sensor.gain_V_per_m,
    )  # fmt: skip


def noise_bandwidth_Hz(prototype: Prototype, outer_end_mass: float) -> float:
    """Integral of |T|^2 over frequency, Hz, with T from sensor noise (as displacement) to tip motion, L_1 / (1 + L).

    L_1 is the part of the loop L by way of the displacement sensor: all of it but for a law that hears more. By
    quadrature on a grid that is refined around the poles. The tip moves by T times the noise where the sensor has no
    filter; with one it moves by a little more near the filter's break.
    """
    closed = loop(prototype)
    here = closed.at(outer_end_mass)
    grid = here.grid_Hz(1e-4, 1e5, 4000, np.linspace(-30, 30, 601))
    s, cut = 2j * pi * grid, closed.cut.at(exact(outer_end_mass))  # 1 + L - L_1, over what 1 + L has below
    transmitted = np.abs(1 - at_points(cut, s) / at_points(here.characteristic, s)) ** 2
    return float(np.trapezoid(transmitted, grid) + transmitted[0] * grid[0])


def _proved_above(prototype: Prototype, masses_kg: tuple[float, float], break_Hz: float) -> bool:
    """Whether every break from this one up is proved stable with every outer end mass."""
    varied, name, factor = ["sensor_lag.break_Hz"], "sensor_lag_break_Hz", 1.0
    if prototype.sensor.filter_Hz is None:
        varied, name, factor = [], "filter_frequency", 2 * pi
    ends = (factor * break_Hz, factor * _breaks_Hz(prototype)[1])

    def proved(stage: InStage) -> bool:
        box = box_with_effects(stage.prototype, {"outer_end_mass": stage.outer_end_mass_kg, name: ends})
        family = rig_family(stage.prototype, varied=varied, varying=box.ranges)
        return certify_box(family, box, _BUDGET, volumes=False).stable is True

    return all(map(proved, _lagging_stages(prototype, masses_kg, break_Hz)))


def _kept(found: Performance, nominal: Performance) -> bool:
    (bandwidth, peak), (own_bandwidth, own_peak) = found, nominal
    if bandwidth is None or peak is None or own_bandwidth is None or own_peak is None:
        return False
    return bandwidth >= (1 - KEPT) * own_bandwidth and peak <= (1 + KEPT) * own_peak


def _breaks_Hz(prototype: Prototype) -> tuple[float, float]:
    """Least and largest break of the sensor to ask about: any filter, but what the effect allows beside a filter."""
    if prototype.sensor.filter_Hz is None:
        return _SLOWEST_HZ, _FASTEST_HZ
    parameter = library()["sensor_lag"].parameters[0]
    return parameter.low, parameter.high


def _least(holds: Callable[[float], bool], breaks_Hz: tuple[float, float]) -> float | None:
    """About the least frequency at which something holds, coming from above; None where it does not at the fastest.

    Only frequencies of as many digits as are told are asked about, so that what is told is what holds.
    """
    low, high = breaks_Hz
    if not holds(high):
        return None
    while high > 1.5 * low:  # first in large steps down
        step = _of_four_digits(max(high / 4, low))
        if holds(step):
            high = step
            if high == low:
                return high
        else:
            low = step
            break
    for _ in range(_HALVINGS):
        middle = _of_four_digits(sqrt(low * high))
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _of_four_digits(frequency_Hz: float) -> float:
    return float(f"{frequency_Hz:.4g}")
