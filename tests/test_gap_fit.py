"""Unknowns, weighting, replay and fits, against closed forms and differences."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_sets import believed, measured, only, scenario
from rigs_of_effects import having
from scipy.optimize import least_squares

from beamdesign import InputError, Prototype, read_dataset
from beamdesign.diagnosis.data.dataset import FrequencyResponse
from beamdesign.diagnosis.diagnosis import updated_prototype
from beamdesign.diagnosis.fitting.evidence import evidence_of, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, Fitted, Share, fit
from beamdesign.diagnosis.fitting.fit_cache import fit_cache
from beamdesign.diagnosis.fitting.fitters import refit
from beamdesign.diagnosis.fitting.hypothesis import (
    NOTHING,
    Hypothesis,
    Placement,
    pairs,
    singles,
    subsystem,
    together,
    tolerated,
)
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.fitting.search import search
from beamdesign.diagnosis.fitting.starts import starts
from beamdesign.diagnosis.fitting.weighting import INDEPENDENT, SHARE, weighting
from beamdesign.diagnosis.judgement import evidence as marginal_likelihood
from beamdesign.plant.assembly import fits, structure_of
from beamdesign.plant.effects import causes
from beamdesign.structure.lumped import figures
from beamdesign.validation.truth.case import answer, write_case
from beamdesign.validation.truth.drawing import draw_case


@pytest.fixture(scope="module")
def lagged():
    """A rig with a sensor lag of 250 Hz, a flow gain 4 % up and oil 8 % softer."""
    rig = believed()
    valve = rig.servovalve.but(flow_gain_m3_per_s_per_A=rig.servovalve.flow_gain_m3_per_s_per_A * 1.04)
    actuator = rig.actuator.but(oil_stiffness_N_per_m=rig.actuator.oil_stiffness_N_per_m * 0.92)
    return measured(rig.but(servovalve=valve, actuator=actuator, effects={"sensor_lag": {"break_Hz": 250.0}}))


def test_nothing_moves_the_figures_at_zero():
    rig = believed()
    placement = NOTHING.placement(rig)
    assert len(placement.unknowns) == 13  # ten keys of [tolerance], three of them for both beams
    base = np.linspace(1.0, 2.0, len(placement.assembly.parameters))
    np.testing.assert_array_equal(placement.parameters(base, np.zeros(13)), base)


def test_a_stiffer_beam_keeps_its_damping_ratio():
    """b = 2 zeta sqrt(K M): one tolerance of stiffness (3 %) moves the dashpot by half as much in the logarithm."""
    rig = believed()
    placement = NOTHING.placement(rig)
    z = np.array([1.0 if u.name == "outer_stiffness" else 0.0 for u in placement.unknowns])
    moved = placement.parameters(np.ones(len(placement.assembly.parameters)), z)
    by_name = dict(zip(placement.assembly.parameters, moved, strict=True))
    assert by_name["outer_stiffness"] == pytest.approx(np.exp(0.03), rel=1e-12)
    assert by_name["outer_damping"] == pytest.approx(np.exp(0.015), rel=1e-12)
    assert by_name["inner_damping"] == 1.0


@pytest.mark.parametrize("names", [(), ("sensor_lag",), ("parameter:flow_gain", "unequal_piston_areas")])
def test_slopes_of_parameters_agree_with_differences(names):
    placement = Hypothesis(names).placement(believed())
    base = np.linspace(1.0, 2.0, len(placement.assembly.parameters))
    z = np.linspace(-0.5, 0.5, len(placement.unknowns))
    slopes = placement.slopes(placement.parameters(base, z))
    for k in range(len(z)):
        step = np.eye(len(z))[k] * 1e-6
        found = (placement.parameters(base, z + step) - placement.parameters(base, z - step)) / 2e-6
        np.testing.assert_allclose(slopes[:, k], found, rtol=1e-7, atol=1e-7 * np.abs(found).max())


def larger(rig: Prototype, force: float, current: float) -> Prototype:
    """A rig that moves as this one does under so many times the force, whose valve takes so many times the current."""

    def times(factor: float, record, *names: str):
        return record.but(**{name: factor * getattr(record, name) for name in names})

    beams = [times(force, beam, "stiffness_N_per_m", "effective_mass_kg") for beam in (rig.outer_beam, rig.inner_beam)]
    valve = times(force / current, rig.servovalve, "flow_gain_m3_per_s_per_A")
    return rig.but(
        outer_beam=beams[0],
        inner_beam=beams[1],
        actuator=times(force, rig.actuator, "piston_area_m2", "oil_stiffness_N_per_m"),
        servovalve=times(force, valve, "leakage_m3_per_s_per_Pa"),
        controller=times(current, rig.controller, "gain_A_per_V"),
    )


@pytest.mark.parametrize(("force", "current"), [(20.0, 1.0), (0.05, 1.0), (1.0, 100.0)])
def test_what_is_expected_of_causes_goes_with_the_size_of_the_rig(force: float, current: float):
    """By similarity: all forces of two such rigs are in one ratio, all currents in another, at the same motion."""
    factors = {"_N": force, "_N_s_per_m": force, "_N_per_m": force, "_kg": force, "_A": current}
    rig, like = believed(), larger(believed(), force, current)
    for hypothesis in singles(rig):
        for one, other in zip(hypothesis.unknowns(rig), hypothesis.unknowns(like), strict=True):
            if one.kind == "effect":
                factor = next((factors[unit] for unit in factors if one.name.endswith(unit)), 1.0)
                for z in (-0.5, 0.0, 0.5):
                    assert other.value(z) == pytest.approx(factor * one.value(z), rel=1e-12), one.name
                assert other.bounds == pytest.approx(one.bounds), one.name


@pytest.mark.parametrize("slower", [10.0, 0.5])
def test_resonances_are_looked_for_where_the_beams_have_theirs(slower: float):
    """By similarity: every mode of beams of the same stiffness goes with one over the root of their mass."""
    rig = believed()
    beams = [one.but(effective_mass_kg=slower**2 * one.effective_mass_kg) for one in (rig.outer_beam, rig.inner_beam)]
    like = rig.but(outer_beam=beams[0], inner_beam=beams[1])
    for name in ("second_beam_mode", "mount_compliance"):
        (one,), (other,) = (
            [u for u in together(name).unknowns(each) if u.name == f"{name}.frequency_Hz"] for each in (rig, like)
        )
        assert (other.low, other.high) == pytest.approx((one.low / slower, one.high / slower))
        assert other.value(0.5) == pytest.approx(one.value(0.5) / slower)
        slow = rig.but(effects={name: {"frequency_Hz": 0.9 * one.low}})
        with pytest.raises(InputError, match="frequency_Hz"):
            structure_of(slow)
        if slower > 1:
            assert structure_of(like.but(effects=slow.effects)).effects == (name,)


def test_what_a_fit_finds_of_a_cause_is_what_acts():
    placement = together("valve_hysteresis").placement(larger(believed(), 1.0, 100.0))
    z = np.full(len(placement.unknowns), 0.3)
    names = placement.assembly.parameters
    acts = dict(zip(names, placement.parameters(np.ones(len(names)), z), strict=True))
    for unknown in placement.unknowns:
        if unknown.kind == "effect":
            assert acts[unknown.name] == unknown.value(0.3)


def test_a_strong_actuator_may_rub_more_than_the_published_one():
    rub = {"seal_friction": {"coulomb_N": 1500.0}}
    with pytest.raises(InputError, match="must be from 0 to 1000"):
        structure_of(believed().but(effects=rub))
    assert structure_of(larger(believed(), 20.0, 1.0).but(effects=rub)).effects == ("seal_friction",)


def test_orifices_are_looked_for_at_the_supply_pressure_of_the_rig():
    rig = believed().but(supply={"pressure_Pa": 5e6})
    (pressure,) = [u for u in together("pressure_dependent_flow").unknowns(rig) if u.kind == "effect"]
    assert pressure.value(0.0) == pytest.approx(5e6)


def test_figures_without_a_tolerance_stay():
    rig = believed()
    loose = rig.but(tolerance=rig.tolerance.but(flow_gain=0.0))
    assert "flow_gain" not in {u.name for u in tolerated(loose)}
    assert {u.name: u.kind for u in tolerated(loose, ("flow_gain",))}["flow_gain"] == "free"


def test_white_noise_counts_as_what_noise_alone_leaves(lagged):
    """A residual that is the channel's own white noise has the misfit that the weighting expects of it."""
    record = only(lagged, ("command_large",)).records[0]
    quiet = replace(record, measured={"displacement_m": record.measured["displacement_m"]})
    weight = weighting(quiet, ("displacement_m",))
    random = np.random.default_rng(0)
    noise = weight.noise_std[0] * random.standard_normal((200, len(record.times)))
    found = [float(weight(row[:, None]) @ weight(row[:, None])) for row in noise]
    assert np.mean(found) == pytest.approx(weight.expected, rel=0.05)
    assert weight.noise_std[0] == pytest.approx(5e-7, rel=0.1)  # what `gap_sets` has put in


def test_a_relative_error_counts_line_by_line(lagged):
    """An error of one unit's share at every line is worth INDEPENDENT units, whatever the spectrum of the signal."""
    record = only(lagged, ("disturbance_large",)).records[0]
    frequency = np.fft.rfftfreq(len(record.times), record.step)
    lines = np.fft.rfft(np.random.default_rng(4).standard_normal(len(record.times)))
    coloured = np.fft.irfft(lines * np.where(frequency < 420.0, 1 / (1 + frequency), 0.0), len(record.times))
    coloured *= np.minimum(record.times / 0.1, 1.0) ** 3  # a record starts at rest
    weight = weighting(replace(record, measured={"displacement_m": coloured}), ("displacement_m",))
    wrong = SHARE * coloured[:, None]
    # the taper at the record's end takes its mean square, 3/8 over a twentieth, off
    assert float(weight(wrong) @ weight(wrong)) == pytest.approx(INDEPENDENT * (1 - 0.05 * 5 / 8), rel=0.15)


def test_residual_slopes_agree_with_differences(lagged):
    data = only(lagged, ("disturbance_small",))
    piece = evidence_of(data)[0]
    placement = Hypothesis(("sensor_lag",)).placement(data.prototype)
    z = np.full(len(placement.unknowns), 0.2)
    _, slopes = piece.linearised(placement, z)
    for k in (0, 8, len(z) - 1):
        step = np.eye(len(z))[k] * 1e-4
        found = (piece.residual(placement, z + step) - piece.residual(placement, z - step)) / 2e-4
        np.testing.assert_allclose(slopes[:, k], found, atol=2e-5 * np.abs(found).max())


@dataclass(frozen=True)
class Straight:
    """Evidence that is linear in z: y = H z with unit noise."""

    h: np.ndarray
    y: np.ndarray
    name: str = "straight"
    condition: object = None
    expected: float = 1.0
    floor: float = 0.0

    def error(self, residual: np.ndarray) -> float:
        return 0.0

    def residual(self, placement: Placement, z: np.ndarray) -> np.ndarray:
        return self.y - self.h @ z

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.residual(placement, z), -self.h


def test_linear_evidence_gives_the_posterior_mean():
    """Ridge regression, C. M. Bishop, Pattern Recognition and Machine Learning (2006), equations (3.53) and (3.54)."""
    random = np.random.default_rng(1)
    placement = NOTHING.placement(believed())
    count = len(placement.unknowns)
    pieces = [Straight(random.standard_normal((9, count)), random.standard_normal(9)) for _ in range(3)]
    found = fit(NOTHING, placement, pieces, np.zeros(count), 60)
    h, y = np.vstack([p.h for p in pieces]), np.concatenate([p.y for p in pieces])
    covariance = np.linalg.inv(np.eye(count) + h.T @ h)
    np.testing.assert_allclose(found.z, covariance @ h.T @ y, atol=1e-3)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9)


def test_orifices_that_all_but_stall_are_integrated_in_as_many_steps_as_they_need(monkeypatch):
    """Steps for the poles at rest are too long where the load takes most of the supply: the simulated rig diverges."""
    data = only(measured(believed()), ["command_small", "disturbance_large"])
    placement = Hypothesis(("pressure_dependent_flow",)).placement(data.prototype)
    supply = {"pressure_dependent_flow.supply_pressure_Pa": 6e6}
    z = np.array([u.z(supply[u.name]) if u.name in supply else 0.0 for u in placement.unknowns])

    def simulated():
        return [piece.predicted(placement, z) for piece in record_evidence(data)]

    found = simulated()
    monkeypatch.setattr(Replay, "_enough", lambda *given: 128)
    for own, exact in zip(found, simulated(), strict=True):
        assert np.all(np.linalg.norm(own - exact, axis=0) < 2e-3 * np.linalg.norm(exact, axis=0))
    monkeypatch.setattr(Replay, "_enough", lambda *given: 2)
    quiet, loud = simulated()
    assert quiet == pytest.approx(found[0], abs=1e-3 * np.abs(found[0]).max())
    assert loud is None or np.linalg.norm(loud - found[1]) > 0.1 * np.linalg.norm(found[1])


def test_what_another_law_has_found_to_be_none_begins_at_the_least_that_a_law_takes():
    """One law of a cause may have none of what goes by its logarithm in another: a fit begins at its bound."""
    rig = believed()
    for unknown in (u for single in singles(rig) for u in single.unknowns(rig) if u.kind == "effect"):
        begun = np.clip(unknown.z(0.0), *unknown.bounds)
        assert unknown.value(begun) == pytest.approx(max(unknown.low, 0.0), rel=1e-9, abs=1e-12), unknown.name


def test_bounds_hold():
    """An effect that the evidence would like negative stays at zero, and the other unknowns are solved for that."""
    placement = Hypothesis(("valve_deadband",)).placement(believed())
    at = [u.name for u in placement.unknowns].index("valve_deadband.half_width_A")
    low = placement.unknowns[at].bounds[0]
    h = 10 * np.eye(len(placement.unknowns))
    wanted = np.where(np.arange(len(h)) == at, low - 5.0, 0.5)
    found = fit(Hypothesis(("valve_deadband",)), placement, [Straight(h, h @ wanted)], np.zeros(len(h)), 60)
    assert found.z[at] == pytest.approx(low, abs=1e-9)
    np.testing.assert_allclose(np.delete(found.z, at), 0.5 * 100 / 101, rtol=2e-3)


@pytest.mark.parametrize("effect", sorted(causes()))
def test_figures_at_their_bounds_make_a_rig(effect):
    """Logarithm and exponential give a bound back within an ulp; beyond it no rig would take the figure."""
    rig = having(believed(), effect)
    unknowns = [u for u in Hypothesis((effect,)).placement(rig).unknowns if u.name.startswith(effect + ".")]
    assert unknowns
    for u in unknowns:
        for bound, z in zip((u.low, u.high), u.bounds, strict=True):
            if np.isfinite(z):
                assert u.value(z) == bound


def test_a_sensor_lag_is_found_with_the_figures_that_moved(lagged):
    hypothesis = Hypothesis(("sensor_lag",))
    placement = hypothesis.placement(lagged.prototype)
    evidence = evidence_of(lagged)
    found = fit(hypothesis, placement, evidence, np.zeros(len(placement.unknowns)))
    values, errors = found.values, found.standard_errors
    assert values["sensor_lag.break_Hz"] == pytest.approx(250.0, rel=0.03)
    believed_oil = lagged.prototype.actuator.oil_stiffness_N_per_m
    assert values["oil_stiffness"] == pytest.approx(0.92 * believed_oil, abs=3 * errors["oil_stiffness"])
    assert found.misfit < 1.3 * sum(e.expected for e in evidence)


def test_an_unstable_start_is_said(lagged):
    placement = NOTHING.placement(lagged.prototype)
    z = np.array([60.0 if u.name == "flow_gain" else 0.0 for u in placement.unknowns])
    found = fit(NOTHING, placement, evidence_of(lagged), z)
    assert found.reason == "the model's loop is unstable where the fit begins"
    assert found.misfit == np.inf


def test_a_believed_loop_that_is_unstable_is_refused(lagged):
    valve = lagged.prototype.servovalve
    wild = lagged.prototype.but(servovalve=valve.but(flow_gain_m3_per_s_per_A=8 * valve.flow_gain_m3_per_s_per_A))
    with pytest.raises(InputError, match="prototype: its loop is unstable with the controllers and masses"):
        search(replace(lagged, prototype=wild))


def test_what_the_believed_loop_does_not_predict_is_named_beside_records_that_it_does(lagged):
    lines = np.geomspace(2.0, 200.0, 20)
    wild = lagged.records[0].controller.but(gain_A_per_V=5.0)
    taken = FrequencyResponse("sweep", lines, np.full(20, 1e-6 + 0j), False, None, 0.0, 0.0, wild)
    with pytest.raises(InputError) as refused:
        search(replace(lagged, responses=(taken,)))
    assert [problem.key for problem in refused.value.problems] == ["frequency_response"]
    assert "sweep" in refused.value.problems[0].reason


def test_amended_prototype_simulates_as_the_fit_does(lagged):
    hypothesis = Hypothesis(("sensor_lag",))
    placement = hypothesis.placement(lagged.prototype)
    z = np.linspace(-1.0, 1.0, len(placement.unknowns))
    rig = updated_prototype(
        lagged.prototype, Fit(hypothesis, placement.unknowns, z, 0.0, (Share(0.0, z, np.eye(len(z))),))
    )
    base = figures(lagged.prototype)
    moved = figures(rig)
    for k, unknown in enumerate(placement.unknowns):
        if unknown.name in moved and not unknown.name.endswith("damping"):
            assert moved[unknown.name] == pytest.approx(base[unknown.name] * np.exp(unknown.spread * z[k]), rel=1e-12)
    p = placement.parameters(np.array([base.get(n, 1.0) for n in placement.assembly.parameters]), z)
    at = placement.assembly.parameters.index("outer_damping")
    assert moved["outer_damping"] == pytest.approx(p[at], rel=1e-12)
    assert rig.effects["sensor_lag"]["break_Hz"] == pytest.approx(placement.unknowns[-1].value(z[-1]))


def test_names_of_hypotheses():
    rig = believed()
    assert together("sensor_lag", "seal_friction") == together("seal_friction", "sensor_lag")
    assert str(NOTHING) == "tolerances only"
    assert subsystem("parameter:oil_stiffness") == "oil"
    alone = singles(rig)
    laws_of_one_effect = together("sensor_lag", "sensor_lag_second_order")
    assert laws_of_one_effect.causes == ("sensor_lag",)
    assert str(together("sensor_lag_second_order", "seal_friction")) == "seal_friction + sensor_lag"
    laws = sum(
        1 for name, law in causes().items() if law.realises and fits(name, rig.rig)
    )  # one more for an effect each, no pair with it
    assert len(pairs(alone)) == len(alone) * (len(alone) - 1) // 2 - laws
    assert laws_of_one_effect not in pairs(alone)
    assert Hypothesis(("parameter:stiffness",)).figures == ("outer_stiffness", "inner_stiffness", "torsional_stiffness")
    assert scenario().record[0].name == "command_small"


def test_a_magnets_hysteresis_is_told_from_a_spools(tmp_path):
    """The truth is compiled plays of equal weight, marched by another scheme; friction on the spool is no match."""
    case = draw_case(4, "single", short=True, names=("valve_hysteresis",))
    write_case(case, tmp_path)
    told = answer(case)["parameters"]["valve_hysteresis"]
    assert told["figures"]["magnet_share"] > 0
    data = read_dataset(tmp_path)
    evidence = record_evidence(replace(data, records=data.records[:2]))
    expected = sum(piece.expected for piece in evidence)
    fits = {}
    for name in ("valve_hysteresis", "valve_hysteresis_magnetic"):
        placement = Hypothesis((name,)).placement(data.prototype)
        begun = starts(placement, {}, evidence, most=1)
        fits[name] = fit(Hypothesis((name,)), placement, evidence, begun[0])
    friction, magnet = fits["valve_hysteresis"], fits["valve_hysteresis_magnetic"]
    assert magnet.misfit - expected < (friction.misfit - expected) / 3
    assert magnet.values["valve_hysteresis_magnetic.half_width_A"] == pytest.approx(told["half_width_A"], rel=0.1)


def test_the_error_of_a_record_is_that_of_its_displacement(lagged):
    """Parseval: over what is weighed, a displacement off by a factor is off by that factor less one, squared."""
    piece = record_evidence(lagged)[0]
    column = piece.weight.channels.index("displacement_m")
    residual = np.zeros_like(piece.measured)
    residual[:, column] = 0.1 * piece.measured[:, column]
    assert piece.error(piece.weight(residual)) == pytest.approx(0.01, rel=1e-9)
    others = np.copy(piece.measured)
    others[:, column] = 0.0
    assert piece.error(piece.weight(others)) == pytest.approx(0.0, abs=1e-15)


def test_kept_fits_to_all_records_are_not_taken_for_fits_to_fewer(lagged, tmp_path, monkeypatch):
    """What is held out would otherwise be in the fits that the gap is measured with."""
    monkeypatch.setattr("beamdesign.diagnosis.fitting.search.singles", lambda rig: (Hypothesis(("sensor_lag",)),))
    three = only(lagged, ["command_large", "disturbance_small", "payload_disturbance"])
    kept = fit_cache(tmp_path / "fits", three)
    found = search(three, kept=kept)
    fewer = replace(three, records=three.records[:-1])
    fresh = refit(fewer, found.fits[0])
    for _ in range(2):  # made, and then recalled
        for one, other in zip(refit(fewer, found.fits[0], kept=kept), fresh, strict=True):
            assert len(one.shares) == len(fewer.records)
            np.testing.assert_array_equal(one.z, other.z)
    assert not np.array_equal(fresh[0].z, found.null.z)


@dataclass
class Decaying(Fitted):
    """A exp(-b t) that was measured beside |A - 2|: a curved valley, and a kink in it."""

    times: np.ndarray
    measured: np.ndarray
    sloped: int = 0

    def residual(self, placement, z):
        a, b = z
        return np.append(self.measured - a * np.exp(-b * self.times), abs(a - 2.0))

    def linearised(self, placement, z):
        self.sloped += 1
        a, b = z
        decay = np.exp(-b * self.times)
        rows = np.vstack([np.column_stack([-decay, a * self.times * decay]), [np.sign(a - 2.0), 0.0]])
        return self.residual(placement, z), rows


@pytest.mark.parametrize("start", [(0.1, 0.1), (8.0, -1.0), (-6.0, 4.0)])
def test_a_fit_is_the_least_of_cost_with_few_derivatives(start):
    """As scipy's least squares find it, with the priors as residuals; derivatives are worked out but now and then."""
    times = np.linspace(0, 3, 40)
    piece = Decaying(times, np.exp(-0.7 * times) + 0.01 * np.sin(9 * times))
    wide = SimpleNamespace(unknowns=(SimpleNamespace(bounds=(-9.0, 9.0), linear=True),) * 2)
    found = fit(NOTHING, wide, [piece], np.array(start))
    assert piece.sloped <= 4  # 5 to 10 where every step has its own
    best = least_squares(lambda z: np.append(piece.residual(wide, z), z), start, xtol=1e-14, ftol=1e-14)
    assert found.cost == pytest.approx(2 * best.cost, rel=2e-4)
    assert found.cost == pytest.approx(sum(s.c for s in found.shares) + found.z @ found.z, rel=1e-12)
    residual, rows = piece.linearised(wide, found.z)
    np.testing.assert_allclose(found.shares[0].a, rows.T @ rows, rtol=0.2, atol=0.2)
    np.testing.assert_allclose(found.shares[0].g, rows.T @ residual, atol=0.1)


@dataclass
class Endless(Fitted):
    """Less is left the further it goes, for ever, and slopes promise it rightly."""

    looked: int = 0

    def residual(self, placement, z):
        self.looked += 1
        return 1e4 * np.exp(-z / 100)

    def linearised(self, placement, z):
        return 1e4 * np.exp(-z / 100), np.diag(-1e2 * np.exp(-z / 100))


def test_a_figure_of_small_tolerance_is_found_however_many_of_these_it_is_off():
    """By its posterior mean (Bishop, equation 3.53): 90 tolerances of 1 % off, where fits stopped after 48 of them."""
    unknowns = tuple(SimpleNamespace(bounds=(-np.inf, np.inf), linear=False, spread=s) for s in (0.01, 0.3))
    h = np.array([[30.0, 1.0], [2.0, 50.0], [7.0, 3.0]])
    piece = Straight(h, h @ np.array([90.0, 1.5]))
    found = fit(NOTHING, SimpleNamespace(unknowns=unknowns), [piece], np.zeros(2))
    exact = np.linalg.solve(np.eye(2) + h.T @ h, h.T @ piece.y)
    np.testing.assert_allclose(found.z, exact, rtol=1e-3)


@pytest.mark.parametrize("slope", [0.0, -50.0, 50.0])
def test_a_fit_that_was_broken_off_is_worth_what_it_has_reached(slope: float):
    """Laplace's method at the fit: cost and curvature there, and nothing of what its slope promises elsewhere.

    D. J. C. MacKay, Information Theory, Inference, and Learning Algorithms (2003), equation (27.3).
    """
    unknown = SimpleNamespace(kind="figure", name="oil_stiffness")
    share = Share(100.0, np.array([slope - 0.5]), np.array([[3.0]]))
    found = Fit(NOTHING, (unknown,), np.array([0.5]), 100.25, (share,))
    assert marginal_likelihood(found, 1.0) == pytest.approx(-0.5 * (100.25 + np.log(4.0)))


def test_a_slope_that_never_ends_is_left_after_so_many_steps():
    """Where each step kept its promise, figures went to where no rig is, and models to thousands of steps a sample."""
    unknown = SimpleNamespace(bounds=(-1e3, 1e3), linear=False, spread=0.3)
    wide, piece = SimpleNamespace(unknowns=(unknown,)), Endless()
    found = fit(NOTHING, wide, [piece], np.zeros(1), 5)
    assert piece.looked <= 2 * 5
    assert 10 < found.z[0] <= 2 * 2 * 5


def test_inputs_of_many_steps_are_kept_one_at_a_time(lagged):
    """A law that grew stiff kept gigabytes of one record."""
    job = record_evidence(lagged)[0].job
    for steps in (1, 2, 400, 500, 600):
        assert len(job._driven(steps)) == 2 * steps * (len(job.record.times) - 1) + 1
    assert [*job._inputs] == [600]
    job._driven(2)
    assert [*job._inputs] == [600, 2]


def test_a_model_far_stiffer_than_the_believed_one_is_not_simulated(lagged):
    """A valve a thousand times as quick moves the tip no other than one ten times, and took 22 GB of inputs."""
    job = record_evidence(lagged)[0].job
    hypothesis = Hypothesis(("parameter:valve_natural_frequency",))
    placement = hypothesis.placement(lagged.prototype)
    (k,) = (k for k, u in enumerate(placement.unknowns) if u.name == "valve_frequency")

    def moved(times: float):
        z = np.zeros(len(placement.unknowns))
        z[k] = placement.unknowns[k].z(times * placement.unknowns[k].nominal)
        return job.simulated(placement, z, ("displacement_m",))

    ten, thirty, thousand = map(moved, (10.0, 30.0, 1000.0))
    assert thousand is None
    assert np.linalg.norm(thirty - ten) < 0.05 * np.linalg.norm(ten)
    assert max(job._inputs) <= 32 * job._believed_steps()
