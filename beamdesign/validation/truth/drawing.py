"""Cases drawn by seed: rig, tolerances, background, and effects strong enough to matter and weak enough to run.

The gain at which the loop begins to oscillate is known from the true rig, linearised at rest by differences.
"""

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from scipy.linalg import matrix_balance

from beamdesign.validation.truth.arm import with_arm
from beamdesign.validation.truth.case import Case, Departure, Drive, Run, noise_free, relative_floor, relative_gap, take
from beamdesign.validation.truth.effects import KINDS, Scales, Shape, rounded
from beamdesign.validation.truth.nominal import Table, assembled, draw_nominal, draw_true, rig_figures, tolerance_of
from beamdesign.validation.truth.rates import (
    INNER,
    PRESSURE_A,
    PRESSURE_B,
    STATES,
    SUPPLY,
    TIP,
    measured_volts,
    rates_at,
)  # fmt: skip
from beamdesign.validation.truth.rig import Motion, Noise, controller_figures, observer
from beamdesign.validation.truth.rig_kinds import PARAMETERS, Rig, on


def jacobian(figures: np.ndarray, modes: np.ndarray, every: bool = False) -> np.ndarray:
    """(n, n) derivative of the rates by those states that take part, by central differences about rest.

    Dead time, play and digital steps are left out.

    Args:
        figures: of the rig.
        modes: of its outer beam.
        every: whether by all states that there may be.
    """
    matrix = np.zeros((STATES, STATES))
    for k in range(STATES):
        step = 1.0 if k in (PRESSURE_A, PRESSURE_B, SUPPLY) else 1e-9  # pressures are in Pa
        ahead, behind = np.zeros(STATES), np.zeros(STATES)
        ahead[k], behind[k] = step, -step
        matrix[:, k] = (rates_at(ahead, figures, modes) - rates_at(behind, figures, modes)) / (2 * step)
    used = np.nonzero(matrix.any(axis=1))[0]
    return matrix if every else matrix[np.ix_(used, used)]


def linear_critical_gain(figures: np.ndarray, modes: np.ndarray) -> float:
    """Least gain in A/V at which the linearised loop is not stable, by bisection; infinite where there is none to 1e5.

    Args:
        figures: whose own gain does not matter.
        modes: of the outer beam.
    """
    trial = figures.copy()

    def stable(gain: float) -> bool:
        trial["gain"] = gain
        balanced, _ = matrix_balance(jacobian(trial, modes), permute=False)
        return bool(np.linalg.eigvals(balanced).real.max() < 0.0)

    low = 1e-5
    high = low
    while stable(high):
        low, high = high, 2 * high
        if high > 1e5:
            return float("inf")
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return 0.5 * (low + high)


Kind = Literal["null", "single", "pair", "outside", "parameter", "triple", "alone"]
KIND_NAMES = get_args(Kind)
Hiss = Literal["white", "coloured", "outliers"]
_VALVE_A, _MOTOR_A = 7.5e-3, 5.0  # RMS of a current in a record, about
GAPS = (2.0, 30.0)
"""Range of the gap over the floor that effects are drawn for."""
_LARGEST_TOLERANCE_GAP = 0.35
_LEAST, _MOST = 1.5, 60.0
_BRIEF_S = 0.75
_BACKGROUND_AT_MOST = 1.2
"""Gap of the background over the floor."""

_BACKGROUND = {
    "sensor_lag": 0.1, "unequal_piston_areas": 0.05, "entrained_air": 0.05, "seal_friction": 0.03,
    "valve_deadband": 0.02, "valve_hysteresis": 0.03, "mount_compliance": 0.02, "second_beam_mode": 0.05,
    "sensor_cubic": 0.01, "structural_damping": 0.02, "coil_lag": 0.08, "command_hum": 0.03, "beam_hardening": 0.01,
    "flow_gain_drift": 0.01,
}  # fmt: skip
"""Severity at which an effect is no more than what any rig has of it."""

_FULL = (
    ("01_command_small", "command_V", "lines", 0.02, 300.0, "lag", False),
    ("02_command_large", "command_V", "lines", 0.25, 300.0, "lag", False),
    ("03_disturbance_small", "disturbance_N", "lines", 30.0, 300.0, "lag", False),
    ("04_disturbance_large", "disturbance_N", "lines", 300.0, 200.0, "lag", False),
    ("05_load_steps", "disturbance_N", "steps", 900.0, 0.0, "proportional", False),
    ("06_payload_disturbance", "disturbance_N", "lines", 120.0, 150.0, "lag", True),
    ("07_payload_command", "command_V", "lines", 0.1, 200.0, "lag", True),
    ("08_command_second", "command_V", "lines", 0.12, 250.0, "proportional", False),
)
_SHORT = (0, 1, 3, 4, 5)
_WEIGHTS = (1.0, 10.0), (0.02, 0.1), (0.005, 0.05)
"""Of an observer's design: break of the force in Hz, weight of the current, noise of the sensors; from, to."""


def draw_case(
    seed: int, kind: Kind, *, short: bool = False, names: tuple[str, ...] = (), rig: Rig = "lag", noise: Hiss = "white"
) -> Case:
    """Draw one case; the same arguments give the same case.

    Args:
        seed: not negative.
        kind: null (tolerances and background only), single, pair, triple, outside (an effect the contract does not
            name), parameter (a plain wrong figure), or alone (a single effect, to be found without records).
        short: five records of 1.75 s instead of eight of 4 s.
        names: effects to put in, none into a null; `parameter:NAME` for a wrong figure.
        rig: actuator and law, see `effects.Rig`.
        noise: of the sensor, white or part of it low-passed; with `outliers` the recorder spoils samples as well.

    Raises:
        ValueError: for a kind, a rig or a noise that is none of these, an unknown name, or one that no such rig has.
    """
    for given, all_of in ((rig, get_args(Rig)), (noise, get_args(Hiss))):
        if given not in all_of:
            raise ValueError(f"there are {', '.join(all_of)}, and no {given!r}")
    if kind not in KIND_NAMES:
        raise ValueError(f"kind is one of {', '.join(KIND_NAMES)}, not {kind!r}")
    for name in names:
        known = name.removeprefix("parameter:") in PARAMETERS if name.startswith("parameter:") else name in KINDS
        if not known:
            raise ValueError(f"no effect {name!r}")
        if not on(rig, [name.removeprefix("parameter:")]):
            raise ValueError(f"no rig of kind {rig} has {name}")
    rng = np.random.default_rng([seed, KIND_NAMES.index(kind), int(short)])
    notes: list[str] = []
    for attempt in range(20):
        nominal = draw_nominal(rng, f"rig-{seed}", rig == "ball_screw")
        nominal = with_arm(nominal, rng) if rig == "arm" else nominal
        case = _with_background(_bare_case(seed, kind, nominal, rng, short, rig, noise), rng)
        if case is None:
            notes.append(f"attempt {attempt + 1}: the rig was not stable, or too lively, with its tolerances")
            continue
        if (found := _with_effects(case, names, rng, notes)) is not None:
            return replace(found, notes=tuple(notes))
    raise ValueError(f"no stable case after 20 attempts: {'; '.join(dict.fromkeys(notes))}")


def _bare_case(
    seed: int, kind: str, nominal: Table, rng: np.random.Generator, short: bool, rig: Rig, hiss: Hiss
) -> Case:
    factors = draw_true(nominal, rng)
    habits = {
        "bulk_modulus": float(rng.uniform(0.9e9, 1.5e9)),
        "supply": float(rng.uniform(14e6, 21e6)),
        "leakage_across": float(rng.uniform(0.1, 0.8)),
        "stroke_on": 1.0,
    }
    stiffness, volts = nominal["outer_beam"]["stiffness_N_per_m"], nominal["sensor"]["gain_V_per_m"]
    load, command = stiffness / 486800, volts / 1180
    runs = _runs(nominal, rng, load, command, short, rig)
    noise = Noise(
        displacement_m=float(rng.uniform(0.3e-6, 0.7e-6)),
        quantum_m=float(rng.choice([1e-7, 2e-7, 3e-7, 5e-7])),
        force_N=float(rng.uniform(0.3, 0.8) * load),
        current_A=float(rng.uniform(1e-5, 3e-5)),
        drift_m=float(rng.uniform(0, 0.4e-6)),
    )
    if hiss != "white":
        noise = replace(noise, coloured=float(rng.uniform(0.3, 0.9)), break_Hz=float(np.exp(rng.uniform(3.0, 5.3))))
    if hiss == "outliers":
        noise = replace(noise, outliers=float(rng.uniform(0.3, 2.0)))
    scales = Scales(rig_figures(nominal, factors, habits), 900 * load, _VALVE_A)
    case = Case(seed, kind, nominal, factors, habits, (), (), runs, noise, 1.75 if short else 4.0, scales, rig=rig)
    large = next(run for run in runs if run.name == "04_disturbance_large")
    current = float(np.std(take(case, large, duration_s=1.5).current))
    if rig == "ball_screw":  # a motor's currents are larger, and what measures them is as much coarser
        noise = replace(noise, current_A=noise.current_A * current / _VALVE_A)
    return replace(case, scales=replace(scales, current=current), noise=noise)


def _runs(
    nominal: Table, rng: np.random.Generator, load: float, command: float, short: bool, rig: Rig
) -> tuple[Run, ...]:
    payload = round(float(rng.uniform(4.0, 9.0)) * nominal["outer_beam"]["effective_mass_kg"] / 3.9, 1)
    pole, zero = rounded(1.75 * rng.uniform(0.7, 1.4)), rounded(26 * rng.uniform(0.8, 1.25))
    fraction = float(rng.uniform(0.3, 0.42))
    rest = rig_figures(nominal, {}, {})
    shape: Table = {"kind": "lag", "pole_Hz": pole, "zero_Hz": zero}
    if rig == "structured":
        shape |= {"kind": "structured", "section": [_section(rng) for _ in range(rng.integers(2, 4))]}
    if rig == "observer":
        shape = _observer(rest, rng)
    added = _added_mass(rest, shape, payload)
    controllers: dict[tuple[str, bool], dict[str, Any]] = {}
    for kind, loaded in (("lag", False), ("proportional", False), ("lag", True)):
        table: dict[str, Any] = {"kind": kind, "gain_A_per_V": 1.0} | (shape if kind == "lag" else {})
        masses = {"outer_end_mass": payload, "inner_end_mass": added} if loaded else {}
        law = controller_figures(table)
        gain = fraction * linear_critical_gain(*assembled(rest | law | masses))
        if rig == "ball_screw":  # long before it oscillates, the largest command asks for more than a drive gives
            gain = min(gain, _MOTOR_A / (0.25 * command * abs(law["law"][-1, -1])))
        controllers[kind, loaded] = table | {"gain_A_per_V": rounded(gain)}
    runs = []
    for name, channel, wave, size, highest, kind, loaded in [_FULL[k] for k in _SHORT] if short else _FULL:
        scale = load if channel == "disturbance_N" else command
        drive = Drive(channel, wave, rounded(size * scale), highest, int(rng.integers(2**31)))  # type: ignore[arg-type]
        runs.append(Run(name, drive, controllers[kind, loaded], *((payload, added) if loaded else (0.0, 0.0))))
    return tuple(runs)


def _section(rng: np.random.Generator) -> Table:
    """Zeros and poles of a section not far from each other, as a tuner that grows a law section by section finds them.

    No pole is less damped than 0.15: it would ring in the law itself.
    """
    zero = float(np.exp(rng.uniform(np.log(8), np.log(200))))
    pole = zero * float(np.exp(rng.uniform(-0.5, 0.5)))
    damping = np.exp(rng.uniform(np.log([0.15, 0.15]), np.log([1.2, 2.0])))
    figures = {"zero_Hz": zero, "zero_damping_ratio": damping[0], "pole_Hz": pole, "pole_damping_ratio": damping[1]}
    return {name: rounded(value) for name, value in figures.items()}


def _observer(rest: Shape, rng: np.random.Generator) -> Table:
    """An observer law for the believed rig without payload, which hears the displacement, or one sensor more."""
    record, modes = assembled(rest | {"gain": 1.0})
    each, idle = np.eye(STATES), assembled(rest | {"gain": 0.0})
    current, force = rates_at(0 * each[0], record, modes, 1e-3) / 1e-3, rates_at(0 * each[0], record, modes, 0.0, 1.0)
    a = jacobian(*idle, every=True)
    # At rest both chambers are alike: their mean pressure is moved by nothing and moves nothing.
    used = a.any(axis=1) & ~each[PRESSURE_B].astype(bool)
    whole = each[:, used]
    whole[PRESSURE_B] = -whole[PRESSURE_A]
    sensors = {
        "displacement_m": [measured_volts(state, record[0], modes, 0.0) for state in each],
        "load_pressure_Pa": each[PRESSURE_A] - each[PRESSURE_B],
        "inner_displacement_m": each[INNER],
    }
    sensors_read = ["displacement_m", *((), ("load_pressure_Pa",), ("inner_displacement_m",))[rng.integers(3)]]
    seen = np.array([each[TIP], *(sensors[name] for name in sensors_read)]) @ whole
    hertz, effort, noise = (float(np.exp(rng.uniform(np.log(low), np.log(high)))) for low, high in _WEIGHTS)
    while True:
        law = observer((a @ whole)[used], force[used], current[used], seen, hertz, effort, noise)
        if np.linalg.eigvals(np.array(law["a"])).real.max() < 0:
            return {"kind": "observer", "sensors": sensors_read} | law
        effort *= 2  # in the end it is a Kalman filter, which is stable


def _added_mass(rest: Shape, shape: Table, payload: float) -> float:
    """The mass on the inner tip with which the loop bears the payload at the highest gain, kg."""
    law = controller_figures({"gain_A_per_V": 1.0} | shape)

    def gain(added: float) -> float:
        return linear_critical_gain(*assembled(rest | law | {"outer_end_mass": payload, "inner_end_mass": added}))

    return max((round(float(share * payload), 1) for share in np.linspace(0.2, 1.4, 13)), key=gain)


def _probe(case: Case) -> float:
    return min(1.25, case.duration_s)


def _with_background(case: Case, rng: np.random.Generator) -> Case | None:
    """Put a little of some effects into the rig, together at 0.2 to 0.8 of the floor."""
    without = noise_free(case, _probe(case))
    if not all(motion.bounded for motion in without.values()):
        return None
    nominal = replace(case, factors=dict.fromkeys(case.factors, 1.0))
    tolerances = relative_gap(without, noise_free(nominal, without[case.runs[0].name].duration))  # change them alone
    if tolerances > _LARGEST_TOLERANCE_GAP:
        return None
    floor = relative_floor(case, without)
    chosen = [name for name in _BACKGROUND if rng.uniform() < 0.6 and on(case.rig, [name])]
    aim = float(rng.uniform(0.2, 0.8)) * floor
    shares = rng.dirichlet(np.ones(max(1, len(chosen))))
    brief = noise_free(case, _BRIEF_S)
    drawn = []
    for name, share in zip(chosen, shares, strict=False):
        departure = Departure(name, _BACKGROUND[name] * float(np.exp(rng.normal(0, 0.5))), KINDS[name].shape(rng))
        gap = relative_gap(noise_free(case.only(departure), _BRIEF_S), brief)
        if np.isfinite(gap):
            factor = min(1.0, aim * float(np.sqrt(share)) / max(gap, 1e-12))
            drawn.append(replace(departure, severity=departure.severity * factor))
    trial = replace(case, background=tuple(drawn))
    gap = relative_gap(noise_free(trial, _probe(case)), without)
    gaps = {"background": gap, "floor": floor, "tolerances": tolerances}
    return replace(trial, gaps=gaps) if gap < _BACKGROUND_AT_MOST * floor else None


def _with_effects(case: Case, names: tuple[str, ...], rng: np.random.Generator, notes: list[str]) -> Case | None:
    probe = noise_free(case, _probe(case))
    found: list[Departure] = []
    for name in names:
        aim = float(np.exp(rng.uniform(np.log(GAPS[0]), np.log(GAPS[1]))))
        if (departure := _sized(case, name, probe, aim, rng)) is None:
            notes.append(f"{name}: too weak or not stable at any severity on this rig")
            return None
        found.append(departure)
    without = noise_free(case)
    floor = relative_floor(case, without)
    # Little over the first part of the records may be much over the whole: loads come late.
    if not relative_gap(without, noise_free(replace(case, background=()))) < _BACKGROUND_AT_MOST * floor:
        notes.append("the background is more than that over the whole records")
        return None
    gaps = case.gaps | {"floor": floor}
    for departure in found:
        gaps[departure.name] = relative_gap(noise_free(case.only(departure)), without) if len(found) > 1 else 0.0
    found.sort(key=lambda d: -gaps[d.name])
    whole = case.only(*found) if found else case
    quiet = noise_free(whole) if found else without
    if found:
        gaps["all"] = relative_gap(quiet, without)
    if len(found) == 1:
        gaps[found[0].name] = gaps["all"]
    noisy = {run.name: take(whole, run, noisy=True) for run in whole.runs}
    if not all(np.isfinite(value) for value in (*gaps.values(), relative_gap(noisy, quiet))):
        notes.append(f"{', '.join(names) or 'no effect'}: not stable over the whole records")
        return None
    return replace(whole, gaps=gaps)


def _sized(case: Case, name: str, probe: dict[str, Motion], aim: float, rng: np.random.Generator) -> Departure | None:
    """The effect at the severity that gives a gap, by secants in logarithms on the first part of the records."""
    figure, sign, shape = "", 1.0, Shape()
    if name.startswith("parameter:"):
        figures, _ = PARAMETERS[name.removeprefix("parameter:")]
        figure, sign = str(rng.choice([name for name in figures if name in case.factors])), float(rng.choice([-1, 1]))
        least = 3.5 * tolerance_of(case.nominal, figure)
        low, high = max(least, 0.03), max(1.0, 1.5 * least)
    else:
        shape = KINDS[name].shape(rng)
        low, high = KINDS[name].range

    def at(severity: float) -> Departure:
        return Departure(name, sign * severity, shape, figure)

    floor = relative_floor(case, probe)
    aim *= floor
    low = max(low, 1e-3)
    severity = float(np.sqrt(low * high))
    best: tuple[float, Departure, float] | None = None
    before: tuple[float, float] | None = None
    for _ in range(8):
        gap = relative_gap(noise_free(case.only(at(severity)), _probe(case)), probe)
        if not np.isfinite(gap):
            high = severity
            severity = float(np.sqrt((low if before is None else before[0]) * severity))
            continue
        miss = abs(float(np.log(max(gap, 1e-12) / aim)))
        if best is None or miss < best[0]:
            best = (miss, at(severity), gap)
        if miss < 0.15:
            break
        slope = 1.0
        if before is not None and before[0] != severity and gap != before[1]:
            slope = float(np.clip(np.log(gap / before[1]) / np.log(severity / before[0]), 0.3, 4.0))
        before = (severity, gap)
        following = float(np.clip(severity * (aim / gap) ** (1 / slope), low, 0.98 * high))
        if abs(np.log(following / severity)) < 0.01:
            break
        severity = following
    # What was found may be off what was asked for (a held output is never weak), but not out of all range.
    return best[1] if best is not None and _LEAST * floor < best[2] < _MOST * floor else None
