"""The part of the specification that a controls engineer builds from: certificate, circuit, code, tolerances."""

import hashlib
from decimal import ROUND_CEILING, ROUND_FLOOR
from math import isinf

from beamdesign.build.analogue import AnalogueController
from beamdesign.build.realisation.loop import SampledVerdict
from beamdesign.build.specification import LawSpecification, Specification
from beamdesign.build.tolerances import LARGEST, SAFETY, why_no_box
from beamdesign.build.words_build import masses_text, optional
from beamdesign.proofs.lyapunov import CHANGES_NAME, describe
from beamdesign.quantity_text import decimal, mass_range_text, quantity
from beamdesign.rational import nearest
from beamdesign.report.page import Block, Code, Items, Paragraph, Part, Table
from beamdesign.report.statements import proved_statements


def guaranteed(law: LawSpecification) -> Part:
    """What the certificate says."""
    rig, masses, _ = law.stage
    rows = tuple(
        (one.claim.replace(mass_range_text(masses), masses_text(masses)), one.foundation, one.how)
        for one in proved_statements(law.certificate, rig.goal.compliance_m_per_N)
    )
    blocks: list[Block] = [
        Table(("claim", "foundation", "by"), rows),
        Paragraph(
            "Proved about the linear model with the nominal figures. Bandwidth is the frequency up to which the outer"
            f" tip gives way by no more than {quantity(rig.goal.compliance_m_per_N, 'm/N')}. To prove it again:"
            f" `beamdesign certify --replay certificate{law.stage.suffix}.toml` (SHA-256"
            f" `{hashlib.sha256(law.certificate.text.encode()).hexdigest()}`)."
        ),
    ]
    if law.certificate.scope:
        blocks.append(Items(law.certificate.scope))
    return Part("What is guaranteed", tuple(blocks))


def changes(spec: Specification) -> Part:
    """Which law acts when, and what is proved of the changes."""
    schedule = spec.prototype.schedule
    assert schedule is not None
    assert spec.switching is not None
    rows = tuple(
        (str(k), law.words(), *("any" if isinf(edge) else f"{edge:.6g} kg" for edge in edges))
        for k, ((law, _), edges) in enumerate(zip(schedule.laws, schedule.kept_kg, strict=True), start=1)
    )
    told = schedule.estimator
    rule = (
        f"The payload is estimated every {told.update_s:g} s from current and sensor voltage, sampled every"
        f" {schedule.period_s:g} s; an estimate whose standard deviation is above {told.largest_std_kg:g} kg changes"
        " nothing.",
        "A stage acts on while the estimate lies between its thresholds. Beyond them the stage takes over in which the"
        f" estimate lies deepest, at least {schedule.dwell_s:g} s after the change before. So the payload is one that"
        f" the stage is for as long as the estimate errs by no more than {told.band_kg:g} kg.",
        "The law that takes over goes on from the current and from outputs and rates of second-order sections as they"
        " are, so that nothing jumps; that is what is proved of changes. Circuits that are switched, each with charges"
        " of its own, do not hand over so: of them each stage by itself is proved.",
        "Changes are proved with nominal figures; what follows of stock tubes, sensor, tolerances, circuits and code is"
        " about each stage while it acts, over its own payloads.",
    )
    heads = ("stage", "law", "acts on down to an estimate of", "acts on up to")
    proved = Items(tuple(f"{line[:1].upper()}{line[1:]}." for line in describe(spec.switching)))
    again = Paragraph(f"To prove it again: `beamdesign certify --replay {CHANGES_NAME}`.")
    return Part("Changes of stage", (Table(heads, rows), Items(rule), proved, again))


def controller(spec: LawSpecification) -> Part:
    """The law, figure by figure."""
    law = spec.stage.prototype.controller
    assert law is not None
    words = f"Valve current from command − sensor voltage: {law.words()}."
    if law.added:
        words = f"{words[:-1]}, and from {', '.join(law.added)}, each with its sign turned."
    return Part("Controller", (Paragraph(words), Table(("figure", "value", "means"), tuple(law.rows()))))


_STAGES = {
    "amplifier": "inverting amplifier: R1 to its inverting input, Rf from its output back to it; gain = Rf/R1",
    "lag": "inverting amplifier: R1 to its inverting input, Rf from its output back to it, with the other parts in"
    " series parallel to Rf; gain = Rf/R1, zero = 1/(2π R2 C), pole = 1/(2π (R2 + Rf) C)",
    "lead": "inverting amplifier: R1 to its inverting input, with R2 and C in series parallel to it, Rf from its output"
    " back; zero = 1/(2π (R1 + R2) C), pole = 1/(2π R2 C)",
    "biquad": "inverting biquad of three amplifiers (Fleischer and Tow, Proceedings of the IEEE 61 (1973) 662-663). A,"
    " with C2 back: R2 from the output of C and R5 from the input. B, with C1 and R1 parallel back: R3 from A and R4"
    " from the input. C, with R8 back: R7 from B and R6 from the input; its output is the stage's. (1 + n1 s + n2 s²)/"
    "(1 + d1 s + d2 s²) with d1 = R2 R3 R7 C2/(R1 R8), d2 = R2 R3 R7 C1 C2/R8, n1 = R3 R5 C2 (R7/(R1 R6) − 1/R4),"
    " n2 = R3 R5 R7 C1 C2/R6. A part that is not listed is left out",
}


def circuit(spec: LawSpecification) -> Part:
    """The analogue realisation."""
    if not spec.analogue:
        return Part("Analogue controller", (Paragraph(f"None: {spec.analogue_reason}."),))
    found = spec.analogue
    first = found[0].circuit
    items = []
    for k, stage in enumerate(first.stages, 1):
        words = f"U{k}, {_STAGES[stage.kind]}."
        if stage.turned:
            words += (
                f" {' and '.join(stage.turned)} from the input inverted by a fourth amplifier, Ri into it, Rb back;"
            )
            words += " the formulas have it times −Ri/Rb."
        items.append(words)
    items[0] += " Its R1 stands there twice, from the command and from the inverted sensor voltage −F x."
    which = "the inverted output" if first.inverted else "the output"
    items.append(
        f"U{len(first.stages) + 1}, power amplifier with current feedback: it drives the valve's coil so that the"
        f" voltage over the sense resistor Rs in series with the coil equals {which} of U{len(first.stages)}."
    )
    blocks: list[Block] = [
        Items(tuple(items)),
        Table(
            ("", *(_name(one) for one in found)),
            tuple(_component_rows(found)),
            "Component values and what they realise; bandwidth and peak sensitivity are proved for the nominal values",
        ),
        Table(
            ("tolerances of all components", *(_name(one) for one in found)),
            tuple(
                (
                    f"resistors {100 * at.resistors:g} %"
                    + (f", capacitors {100 * at.capacitor:g} %" if first.has_capacitors else ""),
                    *(one.tolerances[k].verdict for one in found),
                )
                for k, at in enumerate(found[0].tolerances)
            ),
            "Stable with every component anywhere within its tolerance and every payload of the range, all else"
            " nominal",
        ),
        Paragraph(
            "Proved is the box of gain and time constants that encloses all components, which is more than they can"
            " do. The amplifiers count as ideal. Performance within the tolerances of components is not proved."
        ),
    ]
    reasons = dict.fromkeys(
        f"{_name(one)}, {100 * at.resistors:g} % / {100 * at.capacitor:g} %: {at.verdict}, {at.reason}."
        for one in found
        for at in one.tolerances
        if at.reason
    )
    if reasons:
        blocks.append(Items(tuple(reasons)))
    return Part("Analogue controller", tuple(blocks))


def _name(one: AnalogueController) -> str:
    capacitors = f", C of {one.circuit.capacitors}" if one.circuit.has_capacitors else ""
    return f"R of {one.circuit.resistors}{capacitors}"


def _component_rows(found: tuple[AnalogueController, ...]) -> list[tuple[str, ...]]:
    parts = [one.circuit.parts for one in found]
    names = sorted({name for one in parts for name in one}, key=lambda n: (not n[0].isdigit(), n.partition(".")[0], n))
    rows = [
        (name if name == "Rs" else f"U{name.replace('.', ' ')}", *(_value(name, one.get(name)) for one in parts))
        for name in names
    ]
    return [
        *rows,
        (
            "gain realised (error)",
            *(f"{quantity(nearest(o.circuit.gain_A_per_V), 'A/V')} ({100 * o.errors['gain_A_per_V']:+.2f} %)"
              for o in found),
        ),
        ("response, largest error (sampled)", *(f"{100 * o.errors['response']:.2f} %" for o in found)),
        ("stable over the range", *("proved" if o.stable else "refuted" for o in found)),
        ("bandwidth", *(optional(o.bandwidth_Hz, "Hz", ROUND_FLOOR) for o in found)),
        ("peak sensitivity", *(optional(o.peak_sensitivity, "1", ROUND_CEILING) for o in found)),
    ]  # fmt: skip


def _value(name: str, value: float | None) -> str:
    """A part's value as it is printed on it."""
    if value is None:
        return "left out"
    if ".C" in name:
        return f"{decimal(value * 1e9)} nF"
    return f"{decimal(value)} Ω" if value < 1e3 else f"{decimal(value / 1e3)} kΩ"


def code(spec: LawSpecification) -> Part:
    """The difference equation of a law that is realised."""
    found, unboxed = spec.digital, why_no_box(spec.stage.prototype)
    assert found is not None
    law = found.equation
    units = {channel.gain_name: f"   # A/{channel.unit}" for channel in law.asked.channels}
    others = [f"    read {channel.name} in {channel.unit}" for channel in law.asked.channels[1:]]
    text = "\n".join(
        [
            f"rate: {law.rate_Hz:g} Hz",
            *(f"{name} = {value!r}{units.get(name, '')}" for name, value in law.coefficients.items()),
            "at every sample k:",
            "    e = command_V - sensor_V",
            *others,
            *(f"    {line}" for line in law.lines()),
            "    # limit i to the rated current before it is put out",
        ]
    )
    rows = [
        _sampled_row("current put out at the sample", found.at_once, found.reason),
        _sampled_row("current put out one whole period later", found.one_period_late, found.reason),
        (
            f"continuous law with every pure delay from 0 to {decimal(1e6 * found.delay_s)} µs (1.5 periods)",
            {True: "proved", False: "refuted", None: "undecided"}[found.delay_stable],
            f"not looked at: {unboxed}" if unboxed else "zero exclusion over payload and delay",
        ),
    ]
    return Part(
        "Digital controller",
        (
            Paragraph(
                f"Tustin's rule with poles and zeros prewarped each to its own frequency, at {law.rate_Hz:g} Hz,"
                f" {decimal(law.rate_Hz / found.crossover_Hz if found.crossover_Hz else 0.0, 3)} times the highest"
                f" crossover of the loop, {decimal(found.crossover_Hz)} Hz (computed). The static gain is kept."
            ),
            Code(text),
            Table(("the loop is stable for every payload of the range", "foundation", "by"), tuple(rows)),
            Paragraph(
                "The first two rows are about the sampled-data loop itself, with the coefficients as printed: a held"
                " current, exact timing, all other figures nominal. A computation time between none and a period,"
                " jitter, and the resolution of the converters are not covered by them; the third row is about a"
                " continuous loop, which stands for the sampled one only approximately. Bandwidth and peak sensitivity"
                " are not proved for the sampled loop. Put the current out at the next sample: then its timing does not"
                " depend on how long the computation takes."
            ),
        ),
    )


def _sampled_row(words: str, verdict: SampledVerdict | None, reason: str) -> tuple[str, str, str]:
    if verdict is None:
        return words, "not worked out", reason
    if verdict.stable:
        how = f"enclosure of the sampled loop in ball arithmetic, pieces of the payload range: {verdict.pieces}"
        return words, "proved", how
    return words, "refuted (floating point)" if verdict.stable is False else "undecided", verdict.reason


def tolerance_part(spec: Specification) -> Part:
    """Tolerances on every figure."""
    found = spec.tolerances
    if found is None:
        return Part("Tolerances", (Paragraph(f"None is proved: {spec.tolerances_reason}."),))

    def share(value: float, rounding: str = ROUND_FLOOR) -> str:
        return f"± {decimal(100 * value, 3, rounding)} %"

    rows = []
    for figure in found.figures:
        edge = "no limit found" if figure.alone_refuted is None else share(figure.alone_refuted, ROUND_CEILING)
        rows.append(
            (
                figure_words(figure.name),
                share(figure.alone),
                edge,
                share(figure.shared),
                share(figure.specified),
                optional(figure.bandwidth_Hz, "Hz", ROUND_FLOOR),
                optional(figure.peak_sensitivity, "1", ROUND_CEILING),
            )
        )
    tightest = found.figures[0]
    words = [
        f"Alone, tightest is {figure_words(tightest.name)}: stable to {share(tightest.alone)} with all else nominal.",
        f"All figures off by the same share at once, in any directions: proved stable to {share(found.equal)}"
        + (f", refuted at {share(found.equal_refuted, ROUND_CEILING)}." if found.equal_refuted is not None else "."),
        "All at once, each in proportion to what it bears alone: the column together is proved as one box.",
        f"Build to the column specified: what is proved together, divided by {SAFETY:g}, since a rig at the edge of"
        " what is proved hardly damps anything. The acceptance bands are over these.",
        "Bandwidth and peak sensitivity are proved with that one figure at either end of what is specified; between the"
        " ends and for several figures at once they are not proved.",
        "Dashpots are figures of their own: a tolerance of a stiffness or a mass leaves its beam's dashpot as it is.",
    ]
    if found.stated_sigmas is not None:
        words.append(
            f"The prototype's own tolerances, all at once, are proved to {decimal(found.stated_sigmas)} of their"
            " standard deviations."
        )
    heads = (
        "figure", "alone", "alone, refuted at", "together", "specified",
        "bandwidth at its ends", "peak sensitivity at its ends",
    )  # fmt: skip
    caption = (
        f"Relative tolerances with which the loop stays stable for every payload of {masses_text(spec.masses_kg)}"
        f" (proved, asked up to ± {100 * LARGEST:g} %), tightest first"
    )
    names = [law.stage.suffix for law in spec.laws]
    again = (
        f"`beamdesign certify --replay` of {_files('tolerances', names)} proves the box of the column together again,"
        f" or a wider one, of {_files('equal_tolerances', names)} that of equal shares."
    )
    return Part("Tolerances", (Table(heads, tuple(rows), caption), Items(tuple(words)), Paragraph(again)))


def _files(stem: str, suffixes: list[str]) -> str:
    return " and ".join(f"`{stem}{suffix}.toml`" for suffix in suffixes)


def figure_words(name: str) -> str:
    """A figure of the loop in words."""
    special = {
        "controller_gain": "controller gain",
        "inner_damping": "inner dashpot",
        "outer_damping": "outer dashpot",
        "outer_mass": "outer effective mass",
        "inner_mass": "inner effective mass",
        "filter_frequency": "break of the sensor filter",
    }
    return special.get(name, name.replace("_", " "))
