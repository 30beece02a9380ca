"""Hold-out and the closed share of a gap, against sums made by hand."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, only, scenario
from scipy.signal import lfilter

from beamdesign import simulate
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import FREE, NOTHING, together
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.fitting.weighting import rising, weighting
from beamdesign.diagnosis.gap_metrics import Errors, gap, held_out, sizes
from beamdesign.diagnosis.gap_metrics import errors as prediction_errors
from beamdesign.scenario import Measurement


@pytest.fixture(scope="module")
def data():
    return measured(believed())


def errors(
    before: float, tuned: float, after: float, noise: float = 0.01, name: str = "one", written: float | None = None
) -> Errors:
    """White errors of given size on a record of four seconds."""
    random = np.random.default_rng(len(name))
    times = np.arange(8000) * 5e-4
    signals = [size * random.standard_normal(8000) for size in (before, tuned, after)]
    signals.append(signals[-1] if written is None else signals[-1] * written / after)
    return Errors(name, times, np.sin(times), np.ones(8000), *signals, noise)


def test_closed_is_the_share_of_what_can_be_explained():
    found = gap([errors(0.3, 0.2, 0.1)], ())
    assert found.before == pytest.approx(0.3, rel=0.03)
    assert found.closed == pytest.approx((0.09 - 0.01) / (0.09 - 0.0001), abs=0.02)
    assert found.closed_interval[0] < found.closed < found.closed_interval[1]


def test_the_interval_holds_the_share_that_the_written_prototype_closes():
    """Measured is by fits without the held-out records; what is written is fitted to all, and closes more."""
    found = gap([errors(0.3, 0.2, 0.1, written=0.05)], ())
    assert found.closed == gap([errors(0.3, 0.2, 0.1)], ()).closed
    assert found.closed_interval[0] < found.closed < (0.09 - 0.0025) / (0.09 - 0.0001) < found.closed_interval[1]


def test_only_records_that_no_fit_has_seen_count():
    seen, unseen = errors(0.5, 0.4, 0.01, name="seen"), errors(0.2, 0.2, 0.1, name="not seen")
    found = gap([seen, unseen], (1,))
    assert found.before == pytest.approx(0.2, rel=0.03)
    assert [r.held_out for r in found.records] == [False, True]


def test_bands_add_up_to_the_whole():
    """Parseval's theorem; the band below the first edge holds the mean."""
    found = gap([errors(0.3, 0.2, 0.1)], ())
    assert np.sqrt(sum(b.before**2 for b in found.bands)) == pytest.approx(found.before, rel=1e-2)
    assert np.sqrt(sum(b.noise_floor**2 for b in found.bands)) == pytest.approx(found.noise_floor, rel=1e-2)


def test_noise_alone_leaves_nothing_open():
    assert gap([errors(0.3, 0.2, 0.01)], ()).closed_interval[1] == pytest.approx(1.0, abs=1e-3)
    assert gap([errors(0.3, 0.2, 0.1)], ()).closed_interval[1] < 0.95


def test_the_loop_feeds_its_sensors_noise_back(data):
    """White noise in a simulated loop: what is read is the noise itself and the motion that it commands."""
    piece = record_evidence(data)[-1]
    placement, gain = NOTHING.placement(data.prototype), data.prototype.sensor.gain_V_per_m
    still = np.zeros(len(placement.unknowns))
    noise = 1e-6 * np.random.default_rng(3).standard_normal(len(piece.record.times))
    noise[0] = 0.0  # a record begins at rest
    inputs = np.column_stack([np.zeros_like(noise), -gain * noise])
    moved = Replay(replace(piece.record, inputs=inputs), data.prototype).simulated(
        placement, still, ("displacement_m",)
    )
    read = noise + moved[:, 0]
    lines = np.fft.rfftfreq(len(noise), piece.record.step)
    found = np.sqrt(piece.job.noise_power(("displacement_m",), lines)[0][:, 0])
    assert np.std(read) / np.std(noise) == pytest.approx(np.sqrt(np.mean(found**2)), rel=0.01)
    band = (lines > 10) & (lines < 80)  # in which this loop is lively
    power = [np.sum(np.abs(np.fft.rfft(signal))[band] ** 2) for signal in (read, noise)]
    assert power[0] / power[1] == pytest.approx(np.mean(found[band] ** 2), rel=0.15)
    assert power[0] > 1.2 * power[1]


def test_the_lines_of_a_long_record_take_memory_by_their_number_alone(data):
    """Not by the square of the number of states as well, which a record of a million samples has no room for."""
    (piece,) = record_evidence(replace(data, records=data.records[:1]))
    lines = np.linspace(1.0, 5000.0, 50_000)
    piece.job.placed(NOTHING.placement(data.prototype))  # the equations take some to be derived
    tracemalloc.start()
    piece.job.noise_power(("displacement_m",), lines)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50 * 16 * len(lines)


@pytest.mark.parametrize("coloured", [0.0, 0.5, 0.9])
def test_noise_that_rises_to_low_frequency_is_told_from_white_noise(coloured):
    """Against the spectrum of an autoregressive process of first order, sigma^2 (1 - a^2) / |1 - a exp(-i w)|^2."""
    random, step, memory = np.random.default_rng(5), 5e-4, np.exp(-2 * np.pi * 40 * 5e-4)
    lines = np.fft.rfftfreq(4000, step)[1:]
    spectra = []
    for k in range(4):
        slow = lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], random.standard_normal(8000))[4000:]
        noise = np.sqrt(1 - coloured) * random.standard_normal(4000) + np.sqrt(coloured) * slow
        moved = 30.0 * 4**k * (1 + (lines / 50) ** 2) ** -2.0  # what drives a record, ever harder, and its response
        power = np.abs(np.fft.rfft(noise)[1:]) ** 2 / 4000 + moved
        spectra.append((lines, power, moved))
    found = rising(spectra)
    if not coloured:
        assert found is None
        return
    seen = np.array([150.0, 250.0, 400.0])
    exact = coloured * (1 - memory**2) / np.abs(1 - memory * np.exp(-2j * np.pi * seen * step)) ** 2
    assert found(seen) == pytest.approx(exact, rel=0.35)
    # What nobody predicted is noise to whoever sees no drive behind it; a step's spectrum falls as 1/f^2 as well.
    steps = 1e6 / lines**2
    assert rising([(lines, steps * random.exponential(size=len(lines)), steps)]) is None


def test_noise_of_any_colour_is_the_floor(data):
    """A rig without a gap whose sensor's noise rises, inside its loop: the believed figures leave its floor."""
    random, memory = np.random.default_rng(7), np.exp(-2 * np.pi * 30 * data.records[0].step)
    placement, gain = NOTHING.placement(data.prototype), data.prototype.sensor.gain_V_per_m
    still, records = np.zeros(len(placement.unknowns)), []
    for record in data.records:
        white, drawn = 1e-6 * random.standard_normal((2, len(record.times)))
        noise = white + lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], 3 * drawn)
        noise -= noise[0]  # a record begins at rest
        fed = replace(record, inputs=record.inputs - [0.0, gain] * noise[:, None])
        channels = tuple(record.measured)
        moved = Replay(fed, data.prototype).simulated(placement, still, channels).T
        measured_by = dict(zip(channels, moved, strict=True))
        measured_by["displacement_m"] = measured_by["displacement_m"] + noise
        measured_by["current_A"] = measured_by["current_A"] + 1e-5 * random.standard_normal(len(noise))
        records.append(replace(record, measured=measured_by))
    pieces = record_evidence(replace(data, records=tuple(records)))
    left = [np.sum(piece.residual(placement, still) ** 2) for piece in pieces]
    assert sum(left) == pytest.approx(sum(piece.expected for piece in pieces), rel=0.2)
    whites = [replace(piece, weight=weighting(piece.record, piece.weight.channels)) for piece in pieces]
    assert sum(np.sum(piece.residual(placement, still) ** 2) for piece in whites) > 2 * sum(p.expected for p in whites)


def test_noise_is_that_of_the_samples_that_count(data):
    """White noise of known size: what half of a record says of it is what the whole does."""
    record, std = data.records[0], 2e-5
    noisy = record.measured["displacement_m"] + std * np.random.default_rng(7).standard_normal(len(record.times))
    middle = float(record.times[len(record.times) // 2])
    spans = (), ((float(record.times[0]), middle),)
    for left_out in spans:
        taken = replace(record, measured={**record.measured, "displacement_m": noisy}, left_out=left_out)
        (piece,) = record_evidence(replace(data, records=(taken,)))
        placement = NOTHING.placement(data.prototype)
        nothing = Fit(NOTHING, placement.unknowns, np.zeros(len(placement.unknowns)))
        found = prediction_errors(piece, nothing, nothing, nothing)
        assert found.noise * found.rms == pytest.approx(std, rel=0.06)


def test_the_size_of_a_cause_is_what_it_changes_alone(data):
    """Against the simulation of prototypes that hold one effect each, free of noise."""
    both, rig = together("sensor_lag", "valve_deadband", "parameter:flow_gain"), believed()
    unknowns = both.unknowns(rig)
    z = np.array([1.5 if u.kind == "free" else 0.0 for u in unknowns])
    found = sizes(Fit(both, unknowns, z), record_evidence(data))
    quiet = scenario().but(measurement=Measurement())
    wrong = rig.servovalve.but(flow_gain_m3_per_s_per_A=rig.servovalve.flow_gain_m3_per_s_per_A * np.exp(1.5 * FREE))
    rigs = {name: rig.but(effects={name: {}}) for name in ("sensor_lag", "valve_deadband")}
    motions = {
        name: [taken.column("displacement_m") for taken in simulate(each, quiet).records]
        for name, each in ({"": rig, "parameter:flow_gain": rig.but(servovalve=wrong)} | rigs).items()
    }
    for name, size in found.items():
        pairs = zip(motions[name], motions[""], strict=True)
        assert size == pytest.approx(
            np.sqrt(np.mean([np.mean((a - b) ** 2) / np.mean(b**2) for a, b in pairs])), rel=0.02
        )
    assert len(found) == 3


def test_no_more_than_the_gap_is_closed():
    """Where the floor is read too high, what the fit to all records leaves is the most that can be noise."""
    found = gap([errors(0.03, 0.03, 0.02, noise=0.025)], ())
    assert found.noise_floor == pytest.approx(0.02, rel=0.05)
    assert 0.9 < found.closed <= 1.0


def test_no_gap_is_not_closed():
    found = gap([errors(0.01, 0.01, 0.01, noise=0.02)], ())
    assert found.closed == 0.0


def test_held_out_records_are_known_by_their_parts_and_not_the_hardest_driven(data):
    chosen = held_out(data.records)
    assert len(chosen) == 2
    rest = [r for k, r in enumerate(data.records) if k not in chosen]
    for k in chosen:
        record = data.records[k]
        alike = [r for r in rest if r.excitation == record.excitation]
        assert alike
        current = np.abs(record.measured["current_A"]).max()
        assert max(np.abs(r.measured["current_A"]).max() for r in alike) >= current
        assert any(r.outer_end_mass == record.outer_end_mass for r in rest)
        assert all(r.condition != record.condition for r in rest)


def test_of_many_records_a_quarter_is_held_out_by_the_same_rules(data):
    """Fifty, of which no one can look at all 5e10 choices; replicates go together."""
    many = []
    for k in range(25):
        one = data.records[k % len(data.records)]
        own = replace(one, inputs=one.inputs * 3.0 ** (k // len(data.records)), name=f"{k}")
        many += [own, replace(own, name=f"{k} again")]
    chosen = held_out(many)
    assert 6 <= len(chosen) <= 12
    conditions = [many[k].condition for k in chosen]
    rest = [one for k, one in enumerate(many) if k not in chosen]
    assert not any(one.condition in conditions for one in rest)
    for one in (many[k] for k in chosen):
        alike = [other for other in rest if other.excitation == one.excitation]
        assert (
            max(np.abs(other.measured["current_A"]).max() for other in alike) >= np.abs(one.measured["current_A"]).max()
        )
        assert any(other.outer_end_mass == one.outer_end_mass for other in rest)


def test_a_replicate_is_not_held_out(data):
    one = only(data, ("disturbance_large",)).records[0]
    assert held_out((one, replace(one, name="again"))) == ()
    assert held_out((one,)) == ()
