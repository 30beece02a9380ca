"""The page of a diagnosis: self-contained, whole, and its figures those of the records behind it."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from math import nan, pi, sqrt
from pathlib import Path

import numpy as np
import pytest

from beamdesign import Prototype, read_dataset
from beamdesign.bench_prototype import BenchActuator, BenchPrototype, BenchServovalve, read_any_prototype
from beamdesign.cli.gap import echo_diagnosis
from beamdesign.diagnosis.bench_diagnosis import where_of
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import (
    Cause,
    CauseSet,
    Diagnosis,
    Estimate,
    Gap,
    Indicator,
    NextExperiment,
    RecordGap,
    Where,
    updated_prototype,
)
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, Share
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.gain_findings import another_size
from beamdesign.diagnosis.gap_metrics import Errors, errors, gap, in_bands
from beamdesign.diagnosis.redesign import designer_terms, loops_of, payload_range, terms
from beamdesign.prototype import Arm, Payload
from beamdesign.report.gap_folder import bands, gap_report_html, record_picture, write_gap_folder, zoom
from beamdesign.report.gap_tables import HeatMap, closed_text, fitted_figures, indicator_table, place, terms_table
from beamdesign.report.page import Table

SLOW_SENSOR = Path(__file__).parent.parent / "studies" / "gaps" / "slow_sensor"
VOID = {"meta", "link", "br", "img", "path", "use", "rect", "line", "circle", "polygon", "image"}


def fit_at(prototype: Prototype, *names: str, **z: float) -> Fit:
    """A fit with unknowns placed by hand; its curvature makes every standard error 0.1 of a prior."""
    hypothesis = Hypothesis(names)
    unknowns = hypothesis.unknowns(prototype)
    at = np.array([z.get(u.name.replace(".", "_"), 0.0) for u in unknowns])
    count = len(unknowns)
    return Fit(hypothesis, unknowns, at, 10.0, (Share(10.0, np.zeros(count), 99 * np.eye(count)),))


@pytest.fixture(scope="module")
def data() -> Dataset:
    return read_dataset(SLOW_SENSOR)


@pytest.fixture(scope="module")
def found(data: Dataset) -> Diagnosis:
    """A diagnosis put together by hand, with a name and words that would break a page if they were not escaped."""
    null = fit_at(data.prototype, flow_gain=-3.0)
    chosen = fit_at(data.prototype, "sensor_lag", sensor_lag_break_Hz=-0.67)
    null = Fit(null.hypothesis, null.unknowns, null.z, 100.0, (Share(100.0, null.shares[0].g, null.shares[0].a),))
    search = Search(null, (chosen,), 8.0)
    measured = gap([errors(piece, null, chosen, chosen) for piece in record_evidence(data)], (1,))
    maps = {"record": ("command", "steps"), "0-15 Hz": (0.5, 1.0), "15-40 Hz": (2.0, 0.0)}
    where = Where(
        "sensor",
        (15.0, 150.0),
        "with payload",
        "linear",
        (Indicator("equation <b>", "sensor", 0.8, "says 5 < 6 & more", maps),),
        "It lies in the sensor.",
    )
    lag = Cause("sensor_lag", "sensor", 0.93, 0.9, {"break_Hz": Estimate(250.0, 3.0)}, ("flow_gain is odd",))
    other = Cause("parameter:stiffness", "structure", 0.05, 0.1, {"outer_stiffness": Estimate(5.1e5, 1e4)})
    return Diagnosis(
        "rig <script>alert(1)</script>",
        "ambiguous",
        "The gap is a lag. It closes.",
        (lag, other),
        ("sensor_lag",),
        0.02,
        where,
        measured,
        (("sensor_lag", "transport_delay"),),
        NextExperiment("Excite it at 300 Hz.", ("sensor_lag", "transport_delay"), 4.2),
        data.prototype.but(effects={"sensor_lag": {"break_Hz": 250.0}}),
        ("01: is clipped",),
        search,
        written=chosen,
    )


@pytest.fixture(scope="module")
def page(found: Diagnosis, data: Dataset) -> str:
    terms_of = designer_terms(data, found.prototype)
    return gap_report_html(found, {"prototype": "prototype.toml", "json": "diagnosis.json"}, data, terms_of)


class Balanced(HTMLParser):
    """Notes elements left open or closed out of turn, and all identifiers and links."""

    def __init__(self) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.wrong: list[str] = []
        self.identifiers: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for name, value in attrs:
            if name == "id" and value:
                self.identifiers.append(value)
            if name in ("href", "src", "xlink:href") and value:
                self.links.append(value)
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.stack.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag in VOID:
            return
        if not self.stack or self.stack[-1] != tag:
            self.wrong.append(tag)
        else:
            self.stack.pop()


def test_it_is_whole_and_asks_for_nothing(page: str) -> None:
    seen = Balanced()
    seen.feed(page)
    assert seen.wrong == []
    assert seen.stack == []
    assert len(seen.identifiers) == len(set(seen.identifiers))
    assert "script" not in seen.tags
    outside = [link for link in seen.links if not link.startswith(("#", "data:,")) and link != "prototype.toml"]
    assert outside == ["diagnosis.json"]
    assert {link[1:] for link in seen.links if link.startswith("#")} <= set(seen.identifiers)
    assert not re.search(r"url\((?!#)", page)
    assert "@import" not in page


def test_words_of_the_data_are_escaped(page: str) -> None:
    assert "<script>" not in page
    assert "rig &lt;script&gt;" in page
    assert "says 5 &lt; 6 &amp; more" in page


def test_it_says_what_the_diagnosis_says(page: str, found: Diagnosis) -> None:
    text = re.sub(r"<[^>]+>", " ", page)
    assert "The gap is a lag. It closes." in text
    assert "93.0 %" in text
    assert "flow_gain is odd" in text
    assert "sensor lag, or transport delay" in text
    assert "Excite it at 300 Hz." in text
    assert ">15 to 40 Hz</th>" in page
    assert "01: is clipped" in text
    for record in found.gap.records:
        assert record.record in text
    assert "held out" in text
    # 131.7 mA/V is the remedy's rig with 4.4 kg inside: `critical_gain` of the exact polynomial.
    assert "131.7 mA/V at 133.7 Hz" in text


def test_both_themes_and_print(page: str) -> None:
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page
    assert "var(--ink)" in page


def test_without_records_or_fits_there_is_still_a_page(found: Diagnosis) -> None:
    bare = replace(found, search=None, gap=replace(found.gap, records=(), bands=()), verdict="no_gap", chosen=())
    text = gap_report_html(replace(bare, causes=(), classes=(), next_experiment=None), {"json": "d.json"})
    assert "no further measurement" in text
    assert "<figure" not in text


def test_a_law_that_was_learnt_is_drawn_over_its_signal(found: Diagnosis) -> None:
    """As its table has it; a cause without one has no curve."""
    x = np.linspace(-2e-3, 2e-3, 9)
    table = {"current_A": tuple(x), "added_A": tuple(-0.1 * x), "std_A": tuple(0.01 * np.abs(x))}
    learnt = Cause("empirical:current_A", "amplifier", 0.9, 0.8, like="a dead band", table=table)
    page = gap_report_html(replace(found, causes=(learnt, *found.causes), chosen=(learnt.name,)), {})
    assert "a law at the port current A, like a dead band: what it adds, within two deviations" in page
    assert "curve0-" in page
    assert "curve1-" not in page
    for words in (">current_A<", ">added_A<"):
        assert words in page


def test_figures_have_units_and_what_was_left_out_has_words(found: Diagnosis) -> None:
    pairs = tuple(f"sensor_lag + parameter:flow_gain {k}" for k in range(20))
    page = gap_report_html(replace(found, next_experiment=None, left_out=pairs), {"json": "d.json"})
    assert "outer_stiffness_N_per_m = 5" in page
    assert "break_Hz = 250" in page
    assert "sensor lag + a wrong flow gain 11 and 8 more" in page


def test_several_sets_of_causes_are_told_to_remain_only_where_there_are(found: Diagnosis) -> None:
    one = CauseSet(("sensor_lag",), 1.0, 0.01)
    alone = replace(
        found, classes=(), hypotheses=(one, CauseSet(("transport_delay",), 0.0, 0.5)), left_out=("friction",)
    )
    words = "Several sets of causes remain"
    assert words not in gap_report_html(alone, {"json": "d.json"})
    two = replace(alone, hypotheses=(one, CauseSet(("transport_delay",), 0.3, 0.5)))
    assert words in gap_report_html(two, {"json": "d.json"})


def test_an_experiment_for_no_rivals_is_said_to_tell_none_apart(found: Diagnosis, data: Dataset) -> None:
    """Where nothing explains critical gains or responses, the size of the motion is to be varied."""
    asked = another_size(data)
    text = gap_report_html(replace(found, next_experiment=asked), {"json": "d.json"})
    assert asked.text in text
    assert "It tells apart" not in text
    both = replace(asked, separates=("sensor_lag", "transport_delay"), separation=3.0)
    text = gap_report_html(replace(found, next_experiment=both), {"json": "d.json"})
    assert "It tells apart sensor lag, transport delay; expected separation 3 standard deviations." in text


def test_fields_are_plain(found: Diagnosis) -> None:
    fields = found.to_dict()
    assert json.loads(json.dumps(fields)) == fields
    assert fields["effects"][0] == {
        "name": "sensor_lag",
        "probability": 0.93,
        "parameters": {"break_Hz": {"value": 250.0, "std": 3.0}},
        "subsystem": "sensor",
        "share": 0.9,
        "flags": ["flow_gain is odd"],
        "like": "",
        "table": {},
    }
    assert fields["where"]["band_Hz"] == [15.0, 150.0]
    assert fields["gap"]["closed_interval"] == list(found.gap.closed_interval)


def tones(*parts: tuple[float, float], count: int = 4000, step: float = 5e-4) -> Errors:
    """Errors made of sines: (amplitude, frequency)."""
    times = step * np.arange(count)
    wave = np.sum([a * np.sin(2 * pi * f * times) for a, f in parts], axis=0)
    return Errors(
        "tones", times, np.sin(2 * pi * 5 * times), np.ones(count), wave, 0.5 * wave, 0.1 * wave, 0.1 * wave, 1e-3
    )


def test_bands_hold_the_power_of_their_sines() -> None:
    """A sine of amplitude a has the root mean square a over root two, whichever band it is in (whole periods)."""
    made = tones((3.0, 10.0), (0.4, 100.0))
    found = in_bands(made, made.before, np.array([1.0, 50.0, 200.0, 400.0]))
    assert found[:2] == pytest.approx([3 / sqrt(2), 0.4 / sqrt(2)], rel=1e-9)
    assert found[2] < 1e-9
    assert np.sqrt(np.sum(in_bands(made, made.before, bands(made)) ** 2)) == pytest.approx(
        sqrt((9 + 0.16) / 2), rel=1e-9
    )


def test_bands_are_no_finer_than_the_spectrum() -> None:
    edges = bands(tones((1.0, 10.0)))
    assert np.all(np.diff(edges) >= 1 / 2.0)
    assert edges[-1] <= 0.5 / 5e-4


def test_the_zoom_is_where_the_error_is() -> None:
    times = 5e-4 * np.arange(4000)
    burst = np.where((times > 1.2) & (times < 1.3), np.sin(2 * pi * 80 * times), 0.0)
    part = zoom(Errors("burst", times, np.sin(2 * pi * 5 * times), np.ones(4000), burst, burst, burst, burst, 1e-3))
    assert times[part.start] >= 1.19
    assert times[part.stop - 1] <= 1.31


def test_a_model_that_gave_nothing_is_told_from_one_that_is_wrong() -> None:
    made = tones((1.0, 10.0))
    nothing = replace(made, before=made.measured / np.std(made.measured))
    assert nothing.diverged("before")
    assert not nothing.diverged("tuned")


def test_predictions_are_drawn_as_they_are_where_a_span_does_not_count(data: Dataset) -> None:
    """Errors are none in the span and weighed elsewhere; what a model predicts is not."""
    record = data.records[0]
    begin, end = record.times[[800, 1200]]
    knocked = record.measured["displacement_m"] + 0.02 * ((record.times > begin) & (record.times < end))
    taken = replace(record, measured={**record.measured, "displacement_m": knocked}, left_out=((begin, end),))
    (piece,) = record_evidence(replace(data, records=(taken,)))
    null = fit_at(data.prototype)
    predicted = piece.predicted(null.hypothesis.placement(data.prototype), null.z)
    assert predicted is not None
    drawn = record_picture(made := errors(piece, null, null, null)).axes[0].lines[1]
    shown = np.searchsorted(taken.times, np.asarray(drawn.get_xdata()) - 1e-9)
    displacement = predicted[shown, piece.weight.channels.index("displacement_m")]
    assert 1e-6 * np.asarray(drawn.get_ydata()) == pytest.approx(displacement, abs=1e-12)
    assert replace(made, before=made.counted * taken.measured["displacement_m"] / made.rms).diverged("before")


def test_a_share_that_is_not_the_whole_is_not_called_so() -> None:
    assert closed_text(0.9996) == "99.96 %"
    assert closed_text(0.99999999) == "nearly 100 %"
    assert closed_text(0.5) == "50.0 %"
    assert closed_text(-0.25) == "-25.0 %"
    assert closed_text(1.0) == "100 %"


def test_shades_rise_with_the_logarithm() -> None:
    shade = HeatMap("", (), ()).shade
    assert shade(0.0) == 0
    assert shade(1e-3) == 0
    assert shade(1.0) == 1
    assert shade(40.0) == 1
    assert shade(10**-1.5) == pytest.approx(0.5)


def test_figures_beyond_two_tolerances_stand_out(data: Dataset, found: Diagnosis) -> None:
    """A flow gain three tolerances off."""
    assert found.search is not None
    text = gap_report_html(replace(found, chosen=(), written=found.search.null), {"prototype": "p.toml"})
    assert re.findall(r'class="name">([^<]*)</td>(?:(?!</tr>).)*, beyond</td>', text) == ["flow gain"]
    rows = {row.name: row for row in fitted_figures(fit_at(data.prototype, flow_gain=-3.0, oil_stiffness=1.9))}
    assert place(rows["flow gain"].z) == pytest.approx(0.2)
    assert place(rows["outer mass"].z) == 0.5
    # K_q of 11.3 cm3/s/mA, three times 5 % less: exp(-0.15).
    assert rows["flow gain"].fitted.startswith(f"{11.3 * np.exp(-0.15):.4g} ± ")
    assert rows["valve frequency"].nominal == "150 Hz"
    assert rows["flow gain"].spread == pytest.approx(0.1)


def test_tables_of_indicators_become_maps_where_their_columns_are_of_one_kind() -> None:
    banded = indicator_table(
        {"record": ("a", "b"), "condition": ("x", "y"), "1-5 Hz": (1.0, 2.0), "5-9 Hz": (4.0, 0.0)}
    )
    assert isinstance(banded, HeatMap)
    assert banded.columns == ("1-5 Hz", "5-9 Hz")
    assert banded.rows[0][:2] == ("a", "x")
    assert [banded.shade(value) for value in banded.rows[0][2]] == [0.25, 1.0]
    mixed = indicator_table({"record": ("a",), "gain": (1.0,), "delay_s": (1e-3,), "limit_A": (None,)})
    assert mixed == Table(("record", "gain", "delay s", "limit A"), (("a", "1", "0.001", ""),))
    assert indicator_table({}) is None


def test_terms_are_what_is_known_of_the_papers_remedy(remedy: Prototype) -> None:
    """As the README states it, from `certify` over 0 to 20 kg: stable from 1.968 to 17.79 kg only."""
    found = terms(remedy.but(payload=Payload(outer_end_mass_kg=(0.0, 20.0), inner_end_mass_kg=4.5)))
    assert not found.stable
    ((low, high),) = found.stable_ranges_kg
    assert (round(low, 3), round(high, 2)) == (1.968, 17.79)
    assert found.bandwidth_Hz is None
    # The remedy's 150 mA/V lies above the critical gain where it is not stable, without payload.
    assert found.critical[0].gain_A_per_V < 0.15


def test_loops_of_a_set_begin_with_the_prototypes_own(data: Dataset) -> None:
    loops = loops_of(data)
    assert loops[0] == (data.prototype.controller, 4.4, (0.0, 6.8))
    assert {inner for _, inner, _ in loops} == {0.0, 4.4}
    assert payload_range(data) == (0.0, 6.8)


def test_the_figures_shown_are_those_of_the_prototype_written(data: Dataset, found: Diagnosis) -> None:
    """Not those of another law of the same effect, which with more parameters misses less and yet was not chosen."""
    null, law = fit_at(data.prototype), fit_at(data.prototype, "valve_deadband", flow_gain=-2.5)
    other = replace(fit_at(data.prototype, "valve_deadband_rounded", oil_stiffness=2.5), cost=9.0)
    both = replace(found, chosen=("valve_deadband",), search=Search(null, (other, law), 8.0), written=law)
    text = gap_report_html(both, {"prototype": "p.toml"})
    assert re.findall(r'class="name">([^<]*)</td>(?:(?!</tr>).)*, beyond</td>', text) == ["flow gain"]
    shown = {row.name: row.fitted.partition(" ")[0] for row in fitted_figures(law)}
    valve = updated_prototype(data.prototype, law).servovalve
    assert float(shown["flow gain"]) == pytest.approx(1e3 * valve.flow_gain_m3_per_s_per_A, rel=1e-3)
    assert "Fitted figures" not in gap_report_html(replace(found, written=None), {"prototype": "p.toml"})


def test_a_bench_is_presented_like_any_other_rig(tmp_path: Path) -> None:
    """A bench's answer put together by hand: what it says stands in the common form, files and page."""
    rig = BenchPrototype(
        name="bench",
        kind="actuator_bench",
        actuator=BenchActuator(bore_m=0.016, rod_m=0.01, piston_area_m2=1.618e-4, stroke_m=0.2, supply_pressure_Pa=4e6),
        servovalve=BenchServovalve(flow_gain_m3_per_s_per_V=1e-5),
    )
    chosen = ("pressure_dependent_flow",)
    causes = (Cause(chosen[0], "servovalve", 0.97, 1.0, {"supply_pressure_Pa": Estimate(4.1e6, 2e4)}),)
    table = {"condition": ("1 V",), "direction": ("extending",), "speed_m_per_s": (0.05,), "predicted_m_per_s": (0.06,)}
    rows = (RecordGap("1 V, displacement_m", True, 0.08, np.nan, 0.02, 0.01),)
    shown = Diagnosis(
        "a bench",
        "ambiguous",
        "Orifices. And more.",
        causes,
        chosen,
        np.nan,
        where_of(table, rig.actuator.stroke_m, causes, chosen),
        Gap(0.2, 0.19, 0.05, 0.01, 0.94, (0.9, 0.97), rows),
        (),
        NextExperiment("Run the piston out and back at 0.3 V.", (), 7.5, {"command_V": 0.3}),
        rig.but(effects={"pressure_dependent_flow": {"supply_pressure_Pa": 4.1e6}}),
        notes=("areas and orifices help only together",),
    )
    assert shown.where.subsystem == "servovalve"
    assert shown.where.band_Hz == (0.0, 0.25)  # 0.05 m/s over a stroke of 0.2 m
    paths, fields = write_gap_folder(tmp_path, shown)
    assert read_any_prototype(paths["prototype"]) == shown.prototype
    assert fields["effects"][0]["parameters"] == {"supply_pressure_Pa": {"value": 4.1e6, "std": 2e4}}
    assert fields["gap"]["closed"] == 0.94
    assert "0.3 V" in fields["next_experiment"]["text"]
    assert json.loads(paths["json"].read_text())["probability_unknown"] is None
    text = paths["report"].read_text()
    assert "areas and orifices help only together" in text
    assert "1 V, displacement_m" in text


def test_a_place_without_a_band_is_told_without_one() -> None:
    """The time may be up before the band is looked for."""
    assert Where("sensor", (100.0, 400.0), "").place == "sensor, 100 to 400 Hz"
    assert Where("sensor", (0.0, 0.0), "").place == "sensor"
    assert Where("", (0.0, 0.0), "").place == ""


def test_a_verdict_before_all_was_compared_is_one_so_far(found: Diagnosis, capsys: pytest.CaptureFixture[str]) -> None:
    echo_diagnosis(replace(found, name="rig", verdict="unknown", left_out=("joint_backlash",)))
    assert capsys.readouterr().out.startswith("rig: unknown so far\n")
    echo_diagnosis(replace(found, name="rig", verdict="no_gap"))
    assert capsys.readouterr().out.startswith("rig: no gap\n")


def test_of_a_payload_off_the_axis_no_loop_on_it_is_drawn_or_tuned(data: Dataset, found: Diagnosis) -> None:
    rig = data.prototype.but(arm=Arm(plane="z", offset_m=(0.3, 0.0, 0.0)))
    off, beside = replace(data, prototype=rig), replace(found, prototype=rig)
    loops = designer_terms(off, rig)
    (_, believed, diagnosed), *others = terms_table(loops[0]).rows
    assert "off the axis" in believed
    assert believed == diagnosed
    assert others  # of which none would be read as a bandwidth or a gain that there is not
    assert {cell for _, *cells in others for cell in cells} == {""}
    text = gap_report_html(beside, {"prototype": "prototype.toml", "json": "d.json"}, off, loops)
    assert "Compliance with" not in text
    assert "beamdesign tune" not in text
    assert "beamdesign arm prototype.toml" in text
    assert "Compliance with" in gap_report_html(found, {"prototype": "prototype.toml", "json": "d.json"}, data, loops)


def test_what_is_promised_as_diagnosed_says_of_what_motion(data: Dataset, found: Diagnosis, page: str) -> None:
    """Of a joint with play nothing is proved of small motion, however stable its linear members are."""
    assert "linear loops of either prototype; as diagnosed for exactly these figures. " in page
    loose = replace(found, prototype=data.prototype.but(effects={"joint_backlash": {}}))
    loops = designer_terms(data, loose.prototype)
    words = "for exactly these figures, linear members only; of small motion no stability (joint_backlash)"
    assert {loop.diagnosed.holds_for for loop in loops} == {words}
    text = gap_report_html(loose, {"prototype": "prototype.toml", "json": "d.json"}, data, loops)
    assert f"as diagnosed {words}." in text


def test_what_is_proved_of_a_prototype_that_leaves_the_gap_is_no_promise(
    data: Dataset, found: Diagnosis, page: str
) -> None:
    assert "no promise" not in page
    left = replace(found, verdict="unknown", probability_unknown=0.9, gap=replace(found.gap, closed=0.43))
    loops = designer_terms(data, found.prototype)
    text = gap_report_html(left, {"prototype": "prototype.toml", "json": "d.json"}, data, loops)
    assert "leaves 57% of the gap: what is proved of it is no promise of the rig" in text
    assert "leaves the gap:" in replace(left, gap=replace(found.gap, closed=nan)).reserve
    assert not replace(left, gap=replace(found.gap, closed=0.9)).reserve
    # Where time was up before anything needed a cause, tolerances leave no gap of which something could be left.
    assert not replace(left, probability_unknown=0.2, chance=nan).reserve
    assert replace(left, probability_unknown=0.2, chance=0.01).reserve
