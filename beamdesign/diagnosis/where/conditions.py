"""Under which conditions, at which frequencies and in which direction a gap shows."""

from collections.abc import Sequence
from itertools import pairwise
from math import isnan

import numpy as np

from beamdesign.diagnosis.diagnosis import Indicator, Where
from beamdesign.diagnosis.where.residuals import Residual
from beamdesign.plant.assembly import widened

_BANDS_HZ = (0.2, 2.0, 5.0, 10.0, 20.0, 35.0, 60.0, 100.0, 200.0, 400.0)
_MOST = 0.7  # of the misfit: what the band that is named holds
_EXCITED = 0.03  # of the strongest line
_FEWEST = 5
_DENSE = 0.7
_SLOW_HZ = 1.0
_TWICE = 2.0
_LITTLE = 0.1  # of the power
_DRIFT = 0.5  # of the residual's power
_BENT = 0.3  # of the residual's power away from the lines of the input


def lines_of(
    drive: np.ndarray, response: np.ndarray, residual: np.ndarray, noise_std: float
) -> tuple[float, float] | None:
    """Tell linear errors from distortion by the lines of a periodic input.

    R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach (2012), chapter 4.

    Args:
        drive: (N,) input over whole periods.
        response: (N,) to it.
        residual: (N,) of the response.
        noise_std: white, of the response.

    Returns:
        levels of the residual relative to the response: at lines that the input holds, where linear and odd errors are,
        and at lines of its grid that it does not hold, which only what is not linear reaches (noise is taken out). None
        where the input has no lines: its spectrum is dense, or it does not repeat.
    """
    count = len(drive)
    power = np.abs(np.fft.rfft(drive)) ** 2
    held = np.nonzero(power > _EXCITED * power[1:].max())[0] if power[1:].max() > 0 else np.arange(0)
    held = held[held > 0]
    if len(held) < _FEWEST or len(held) > _DENSE * (held[-1] - held[0] + 1):
        return None
    inside = np.arange(held[0], min(3 * held[-1], count // 2))
    # A transform without a window leaks from a line to its neighbours where the record is no whole period.
    beside = (-1, 0, 1) if np.diff(held).min() > 2 else (0,)
    free = np.setdiff1d(inside, np.concatenate([held + k for k in beside]))
    left, whole = np.abs(np.fft.rfft(residual)) ** 2, float(np.sum(np.abs(np.fft.rfft(response)[held]) ** 2))
    noise = noise_std**2 * count

    def level(at: np.ndarray) -> float:
        return float(np.sqrt(max(np.sum(left[at] - noise), 0.0) / whole)) if len(at) else np.nan

    return level(held), level(free)


def setting(found: Sequence[Residual]) -> Where:
    """Look at the residuals of all records by frequency, size, payload, input and direction.

    Returns:
        band, condition and kind, the place open; and what tells them, with a map of the weighted misfit by record,
        condition and band. A gap drifts of which most is slower than 1 Hz and than any input; else it is static or
        linear by how much of it lies away from the lines of the input, where any record has lines.
    """
    low, high = widened(found[0].evidence.job.prototype, _BANDS_HZ[0], _BANDS_HZ[-1])
    edges = np.array([low, *np.array(_BANDS_HZ[1:]) * high / _BANDS_HZ[-1]])
    units, noise = (np.array(parts) for parts in zip(*(_by_band(item, edges) for item in found), strict=True))
    band = _narrowest(np.maximum(units - noise, 0.0).sum(0), edges)
    relative = [_relative(item) for item in found]
    distortions, asymmetries, slow = [], [], []
    for item in found:
        record, weight, column = item.evidence.record, item.evidence.weight, item.evidence.column
        drive = record.inputs[:, 1 if driven_by(item) == "command" else 0]
        shaped = item.left[:, column] * weight.fade
        measured = record.measured["displacement_m"]
        seen = lines_of(drive, measured, shaped, float(weight.noise_std[column]))
        if seen is not None and sum(seen) > 0:
            distortions.append(seen[1] ** 2 / (seen[1] ** 2 + seen[0] ** 2))
        parts = [shaped[measured * sign > 0] for sign in (1, -1)]
        sides = [float(np.sqrt(np.sum(part**2) / max(len(part), 1))) for part in parts]
        asymmetries.append(abs(sides[0] - sides[1]) / max(sum(sides) / 2, 1e-300))
        slow.append(_slow(drive, shaped, record.step))
    names = tuple(f"{low:g}-{high:g} Hz" for low, high in pairwise(edges))
    table: dict[str, tuple[object, ...]] = {
        "record": tuple(item.evidence.name for item in found),
        "condition": tuple(words_of(item) for item in found),
        "relative_error": tuple(relative),
    }
    table |= {name: tuple(float(v) for v in units[:, k]) for k, name in enumerate(names)}
    sizes = ((distortions, np.nan), (asymmetries, 0.0), (slow, 0.0))
    distortion, asymmetry, slowness = (float(np.median(some)) if some else none for some, none in sizes)
    condition = _condition(found, relative)
    text = f"Most of the misfit is between {band[0]:g} and {band[1]:g} Hz; the relative error is {condition}; "
    text += "" if isnan(distortion) else f"{distortion:.0%} of it lies away from the lines of the input; "
    text += f"it differs by {asymmetry:.0%} between the two directions. "
    text += "Figures by record and band are the misfit as fits weigh it, a sum of squares, noise included."
    indicator = Indicator("bands and conditions", "", 0.0, text, table)
    if slowness > _DRIFT:
        kind = "drifting"
    else:
        kind = "" if isnan(distortion) else "static" if distortion > _BENT else "linear"
    return Where("", band, condition, kind, (indicator,))


def words_of(item: Residual) -> str:
    """A record's condition in words."""
    record = item.evidence.record
    mass = f"{record.outer_end_mass:g} kg payload" if record.outer_end_mass > 0 else "no payload"
    by = driven_by(item)
    column, unit = (1, "V") if by == "command" else (0, "N")
    return f"{by}, {float(np.std(record.inputs[:, column])):.3g} {unit} rms, {mass}"


def driven_by(item: Residual) -> str:
    """Which input makes the displacement: `command` or `disturbance` where the other makes less than a tenth of it.

    Of the linear model's response; a force sensor's noise so drives nothing.
    """
    spectrum = item.probe.spectrum(item.evidence.record.inputs)
    through = item.probe.response[:, item.probe.rows(["displacement_m"])[0], :2]
    force, command = (float(np.sum(np.abs(through[:, k] * spectrum[:, k]) ** 2)) for k in (0, 1))
    if max(force, command) <= 0:
        return "none"
    if force < _LITTLE * command:
        return "command"
    return "disturbance" if command < _LITTLE * force else "both"


def _by_band(item: Residual, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Misfit of the displacement per band, and what noise alone leaves of it."""
    weight, column = item.evidence.weight, item.evidence.column
    lines = weight(item.left).reshape(2, -1, len(item.channels))[:, :, column]
    noise = (weight.scale[column] * weight.noise_std[column]) ** 2 * len(item.left)
    powers = np.sum(lines**2, axis=0), noise
    misfit, expected = (np.histogram(weight.frequencies_Hz, edges, weights=power)[0] for power in powers)
    return misfit, expected


def _relative(item: Residual) -> float:
    """Rms error of the displacement over its rms, noise taken out."""
    column, noise = item.evidence.column, item.evidence.weight.noise_std
    left = float(np.mean(item.left[:, column] ** 2)) - float(noise[column]) ** 2
    power = float(np.var(item.evidence.record.measured["displacement_m"]))
    return float(np.sqrt(max(left, 0.0) / power)) if power > 0 else 0.0


def _narrowest(totals: np.ndarray, edges: np.ndarray) -> tuple[float, float]:
    """Fewest neighbouring bands (in octaves) that hold most of the misfit."""
    whole = float(totals.sum())
    if whole <= 0:
        return float(edges[0]), float(edges[-1])
    spans = [
        (np.log2(edges[j] / edges[i]), i, j)
        for i in range(len(totals))
        for j in range(i + 1, len(totals) + 1)
        if totals[i:j].sum() >= _MOST * whole
    ]
    _, i, j = min(spans)
    return float(edges[i]), float(edges[j])


def _condition(found: Sequence[Residual], relative: Sequence[float]) -> str:
    """What makes the relative error of records at least twice as large, all else alike as far as can be."""
    records, driven = [item.evidence.record for item in found], [driven_by(item) for item in found]
    loaded = [k for k, r in enumerate(records) if r.outer_end_mass > 0]
    bare = [k for k in range(len(records)) if k not in loaded]
    commanded, forced = ([k for k in bare if driven[k] == by] for by in ("command", "disturbance"))
    large, small = list[int](), list[int]()
    for group, column in ((commanded, 1), (forced, 0)):
        sizes = {k: float(np.std(records[k].inputs[:, column])) for k in group}
        if sizes and max(sizes.values()) > _TWICE * min(sizes.values()):
            large.append(max(sizes, key=lambda k: sizes[k]))
            small.append(min(sizes, key=lambda k: sizes[k]))
    said = []
    for name, opposite, *groups in (
        ("with payload", "without payload", loaded, bare),
        ("under command", "under disturbance", commanded, forced),
        ("at large amplitude", "at small amplitude", large, small),
    ):
        if not all(groups):
            continue
        one, other = (float(np.sqrt(np.mean([relative[k] ** 2 for k in group]))) for group in groups)
        ratio = one / max(other, 1e-9)
        if ratio >= _TWICE:
            said.append(f"{name} ({ratio:.1f} times)")
        elif ratio <= 1 / _TWICE:
            said.append(f"{opposite} ({1 / max(ratio, 1e-3):.1f} times)")
    return "most " + ", ".join(said) if said else "alike under all conditions measured"


def _slow(drive: np.ndarray, residual: np.ndarray, step: float) -> float:
    """Share of the residual's power that is slower than both 1 Hz and anything that drives the rig."""
    hz = np.fft.rfftfreq(len(drive), step)
    power, driven = np.abs(np.fft.rfft(residual)) ** 2, np.abs(np.fft.rfft(drive)) ** 2
    at = (hz < _SLOW_HZ) & (driven < 1e-3 * driven.max())
    return float(power[at].sum() / max(power.sum(), 1e-300))
