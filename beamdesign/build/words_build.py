"""The part of the specification that a workshop builds from: sections, drawing, masses, ratings, sensor."""

from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN
from math import inf, pi, sqrt

from beamdesign.build.drawing import missing_geometry
from beamdesign.build.ratings import KEPT, MARGIN, StockChoice, held_loads
from beamdesign.build.specification import Specification
from beamdesign.quantity_text import decimal, mass_range_text, quantity, tube_text
from beamdesign.report.page import Block, Items, Paragraph, Part, Picture, Table
from beamdesign.structure.lumped import lumped_beam, notes
from beamdesign.structure.materials import STRENGTH_SOURCE


def optional(value: float | None, unit: str, rounding: str = ROUND_HALF_EVEN) -> str:
    """A quantity, or a dash where there is none; what is proved is to be rounded to the safe side."""
    return "–" if value is None else quantity(value, unit, rounding=rounding)


def masses_text(bounds: tuple[float, float]) -> str:
    """A range of masses, or the one mass that it holds."""
    return f"{bounds[0]:g} kg" if bounds[0] == bounds[1] else mass_range_text(bounds)


def sections(spec: Specification, svg: str) -> Part:
    """Tubes with their nearest stock sizes, and the drawing."""
    if spec.stock is None:
        words = (
            f"No sections and no drawing: {missing_geometry(spec.prototype)}. Build beams with these lumped figures:"
        )
        rows = []
        for name in ("outer", "inner"):
            found = lumped_beam(getattr(spec.prototype, f"{name}_beam"))
            rows += [
                (f"{name} tip stiffness", quantity(found.stiffness, "N/m"), "given"),
                (f"{name} effective mass at the tip", quantity(found.mass, "kg"), "given"),
                (f"{name} dashpot", quantity(found.damping, "N s/m"), "given"),
            ]
        return Part("Sections", (Paragraph(words), Table(("figure", "value", "basis"), tuple(rows))))
    outer, inner = (choice.made for choice in spec.stock)
    table = Table(
        ("", "outer", "inner", "basis"),
        (
            ("outside width × width × wall", outer.size, inner.size, "given"),
            ("material", outer.material, inner.material, "given"),
            *(
                (words, quantity(getattr(outer, key), "m", 5), quantity(getattr(inner, key), "m", 5), "given")
                for words, key in (
                    ("cut length", "length_m"),
                    ("free, clamp to tip", "free_length_m"),
                    ("clamped", "clamped_m"),
                )
            ),
            ("gap per side at assembly", quantity(spec.stock[0].gap_m[0], "m"), "", "computed"),
            ("mass of the tube", quantity(outer.tube_mass_kg, "kg"), quantity(inner.tube_mass_kg, "kg"), "computed"),
            (
                "tip stiffness in the model",
                *(quantity(choice.stiffness_N_per_m[0], "N/m") for choice in spec.stock),
                "given or computed",
            ),
            (
                "effective mass in the model",
                *(quantity(choice.effective_mass_kg[0], "kg") for choice in spec.stock),
                "given or computed",
            ),
        ),
    )
    blocks: list[Block] = [
        Paragraph(
            "Two square tubes, one inside the other, clamped at one end and joined at the tip by an actuator that holds"
            " the outer tip still. The tips lie in one plane; each tube is held from its base end over the clamped"
            " length. The exact figures of everything here are in `prototype.toml`."
        ),
        table,
        Paragraph(f"Proof strengths of materials: {STRENGTH_SOURCE}."),
    ]
    blocks += [Paragraph(f"{note[:1].upper()}{note[1:]}.".replace("_", " ")) for note in notes(spec.prototype)]
    if svg:
        words = "Lengthwise section and cross-section; the same drawing is in `drawing.dxf`, in mm"
        blocks.append(Picture(svg, "drawing.svg", words))
    blocks += [
        Table(
            ("tube", "nearest stock size no less stiff", "what changes"),
            tuple((choice.made.name, tube_text(*choice.stock), _change(choice)) for choice in spec.stock),
            "If stock tubes are used, one exchanged at a time; stability and guarantees with them are proved",
        ),
        Table(
            ("", "tip deflection", "gap left", "basis"),
            tuple(
                (one.case, quantity(one.deflection_m, "m"), quantity(one.gap_left_m, "m"), "computed")
                for one in held_loads(spec.prototype, spec.load_N)
            ),
            f"Held still, with {quantity(spec.load_N, 'N')} across the tip ({spec.load_words})",
        ),
    ]
    if spec.governing:
        words = f"The governing check is {spec.governing}; all checks with their utilisation are in the report."
        blocks.append(Paragraph(words))
    return Part("Sections", tuple(blocks))


def _change(choice: StockChoice) -> str:
    if choice.same:
        return "nothing: it is a stock size"
    if not choice.fits:
        return "it does not fit: no gap is left between the tubes"
    (stiff, stiffer), (mass, heavier) = choice.stiffness_N_per_m, choice.tube_mass_kg
    words = (
        f"stiffness {_signed(stiffer / stiff - 1)}, mass of the tube {_signed(heavier / mass - 1)},"
        f" gap {quantity(choice.gap_m[1], 'm')}; "
    )
    if not choice.stable:
        return words + "the loop is not stable over the range: tune again before using it"
    return words + (
        f"proved stable over the range, bandwidth {optional(choice.bandwidth_Hz, 'Hz', ROUND_FLOOR)}, peak sensitivity"
        f" {optional(choice.peak_sensitivity, '1', ROUND_CEILING)}"
    )


def _signed(share: float) -> str:
    return f"{100 * share:+.1f} %"


def masses(spec: Specification) -> Part:
    """What is fixed to the tips."""
    rig = spec.prototype
    rows = (
        (
            "always fixed to the tip (actuator module)",
            quantity(rig.outer_beam.end_mass_kg, "kg"),
            quantity(rig.inner_beam.end_mass_kg, "kg"),
        ),
        ("to be added", "none", quantity(rig.payload.inner_end_mass_kg, "kg", 7)),
        ("payload, whatever it is", masses_text(spec.masses_kg), "none"),
    )
    return Part(
        "Masses at the tips", (Table(("", "outer tip", "inner tip"), rows), Paragraph("All of them are given."))
    )


def actuator(spec: Specification) -> Part:
    """Ratings of cylinder, valve and supply, and the operating envelope."""
    need, rig = spec.ratings, spec.prototype
    assert need is not None
    area = rig.actuator.piston_area_m2

    def have(key: str, unit: str) -> str:
        return optional(need.given[key], unit)

    def flow(value: float | None) -> str:
        return "–" if value is None else "∞" if value == inf else f"{decimal(6e4 * value)} l/min"

    def current(value: float | None) -> str:
        return "–" if value is None else "∞" if value == inf else f"{decimal(1e3 * value)} mA"

    held_m = need.load_N / lumped_beam(rig.inner_beam).stiffness
    stated = have("supply_pressure_Pa", "Pa")
    valve, margin = rig.servovalve, f"× {MARGIN:g}"
    bore = f"{quantity(area, 'm2')} (bore {quantity(sqrt(4 * area / pi), 'm')} as a full circle)"
    spool = f"{quantity(valve.natural_frequency_Hz, 'Hz')}, {decimal(valve.damping_ratio)}"
    supply = quantity(need.supply_pressure_Pa, "Pa")
    given_current, given_flow = need.given["rated_current_A"], need.given["supply_flow_m3_per_s"]
    rows = (
        ("piston area, mean of both sides", bore, "", "given"),
        ("load pressure that holds the load at rest, F/A", quantity(need.load_N / area, "Pa"), stated, "computed"),
        ("stroke to either side that holds it, at least", quantity(held_m, "m"), "", "computed"),
        ("oil spring K_c", quantity(rig.actuator.oil_stiffness_N_per_m, "N/m"), "", "given"),
        ("largest cylinder force", quantity(need.cylinder_force_N, "N"), "", "computed"),
        ("load pressure at that force", quantity(need.load_pressure_Pa, "Pa"), "", "computed"),
        ("supply pressure of which the load takes 2/3", supply, stated, "computed"),
        ("flow through the valve under load", flow(need.flow_m3_per_s), "", "computed"),
        (f"no-load flow of the valve at the given supply, {margin}", flow(need.no_load_flow_m3_per_s), "", "computed"),
        (f"rated current of the valve, {margin}", current(need.rated_current_A), current(given_current), "computed"),
        (f"stroke from end to end, {margin}", quantity(need.stroke_m, "m"), have("stroke_m", "m"), "computed"),
        (f"flow of the supply, {margin}", flow(need.supply_flow_m3_per_s), flow(given_flow), "computed"),
        ("valve flow gain K_q", quantity(valve.flow_gain_m3_per_s_per_A, "m3/s/A"), "", "given"),
        ("valve natural frequency, damping ratio", spool, "", "given"),
        ("leakage K_pq", quantity(valve.leakage_m3_per_s_per_Pa, "m3/s/Pa"), "", "given"),
    )
    blocks: list[Block] = [
        Paragraph(
            f"For a force on the outer tip with an amplitude of {quantity(need.load_N, 'N')} ({spec.load_words}) at any"
            f" frequency up to the guaranteed bandwidth of {quantity(need.up_to_Hz, 'Hz')}, by the linear loop at both"
            " ends and in the middle of the payload range, the worst of them. The supply must exceed every load"
            " pressure."
        ),
        Table(("figure", "needed", "the prototype states", "basis"), rows),
    ]
    found = need.envelope
    rows_of = tuple(
        (
            quantity(float(f), "Hz"),
            quantity(float(load), "N"),
            governing,
            f"{decimal(1e6 * float(moved))} µm",
        )
        for f, load, governing, moved in zip(
            found.frequency_Hz, found.load_N, found.governing, found.displacement_m, strict=True
        )
    )
    blocks.append(
        Table(
            ("frequency", "largest amplitude of the force", "limited by", "the tip moves by"),
            rows_of,
            "Operating envelope with the largest payload (computed at these frequencies)",
        )
    )
    if found.missing:
        missing = ", ".join(f"{limit} (`{key}`)" for limit, key in found.missing.items())
        blocks.append(Paragraph(f"Not in the envelope, since the prototype does not state them: {missing}."))
    return Part("Cylinder, valve and supply", tuple(blocks))


def sensor(spec: Specification) -> Part:
    """What the sensor must be, as far as that was worked out."""
    rig, need = spec.prototype.sensor, spec.sensor
    heads = ("figure", "needed", "the prototype states", "basis")
    rows = [
        ("gain of sensor and amplifier F", quantity(rig.gain_V_per_m, "V/m"), "", "given"),
        ("low-pass filter after it", quantity(rig.filter_Hz, "Hz") if rig.filter_Hz else "none", "", "given"),
    ]
    if need is None:
        return Part("Sensor", (Table(heads, tuple(rows)),))

    def micrometres(value_m: float | None) -> str:
        return "–" if value_m is None else f"{decimal(1e6 * value_m)} µm"

    stable, performs = (optional(found, "Hz", ROUND_CEILING) for found in (need.stable_from_Hz, need.performs_from_Hz))
    noise = f"{decimal(1e9 * need.noise_density_m_per_rtHz)} nm/√Hz"
    rows += [
        ("bandwidth (first-order break) from which the loop is stable", stable, "", "proved"),
        (f"bandwidth that costs at most {100 * KEPT:g} % of what is guaranteed", performs, "", "proved"),
        ("resolution, at most", micrometres(need.resolution_m), micrometres(need.given_resolution_m), "computed"),
        ("noise density, white, at most", noise, "", "computed"),
        (
            "the same as RMS in the band of such a sensor",
            micrometres(need.noise_m),
            micrometres(need.given_noise_m),
            "computed",
        ),
    ]
    words = (
        f"Stability from that bandwidth is proved for every first-order break up to {need.fastest_Hz:g} Hz and every"
        " payload of the range.",
        f"At the second bandwidth {optional(need.bandwidth_Hz, 'Hz', ROUND_FLOOR)} of loop bandwidth and a peak"
        f" sensitivity of {optional(need.peak_sensitivity, '1', ROUND_CEILING)} are proved.",
        f"The goal allows the tip {micrometres(need.motion_m)} under {quantity(spec.load_N, 'N')}; the sensor may"
        f" cause {100 * need.share:g} % of that: as one step of its resolution, or as RMS motion by its noise, which"
        f" the loop passes with a noise bandwidth of {decimal(need.noise_bandwidth_Hz)} Hz (computed by quadrature at"
        " both ends and in the middle of the range).",
    )
    return Part("Sensor", (Table(heads, tuple(rows)), Items(words)))
