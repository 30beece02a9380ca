"""`beamdesign new`, `explain` and `paper`: files to start from, what a key means, and the source recomputed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

import beamdesign
from beamdesign.cli.command import CommandResult, command, write_drawn
from beamdesign.cli.output import echo, echo_table, path_to_write, progress, refuse, write_json
from beamdesign.files import fresh_folder


def templates(incomplete: str) -> list[tuple[str, str]]:
    """Names of templates, each with what it is for, to complete a word with."""
    from beamdesign.templates import TEMPLATES

    return [(name, each.purpose) for name, each in TEMPLATES.items() if name.startswith(incomplete)]


def words(incomplete: str) -> list[str]:
    """Keys, tables, effects and topics that can be explained, to complete a word with."""
    from beamdesign.docs import words

    return [word for word in words(incomplete) if word.startswith(incomplete)]


@command
def new(
    template: Annotated[str | None, typer.Argument(autocompletion=templates)] = None,
    out: Annotated[Path | None, typer.Option(metavar="PATH", callback=path_to_write)] = None,
    listed: Annotated[bool, typer.Option("--list")] = False,
) -> CommandResult:
    """Start a study, a rig or a data set from a template.

    The file is commented, runs as it stands, and the command to run it with is printed. Nothing that exists is
    overwritten.

    Args:
        template: what to start; without it all are listed.
        out: the new file (folder, for a data set); else named after the template.
        listed: list the templates.
    """
    import difflib
    import shlex

    from beamdesign.templates import TEMPLATES, start, target

    if template is None or listed:
        rows = [(name, each.purpose) for name, each in TEMPLATES.items()]
        echo_table("templates", ("name", "what it starts"), rows)
        echo("beamdesign new NAME --out FILE")
        return CommandResult({"templates": [{"name": name, "purpose": purpose} for name, purpose in rows]})
    if template not in TEMPLATES:
        close = difflib.get_close_matches(template, TEMPLATES, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(TEMPLATES)}"
        refuse("new", (template or "''", f"no such template; {hint}"))
    paths = start(template, out)
    it = target(template, out)
    name = it.resolve().stem  # also of a folder that is here, or above
    quoted = {"it": shlex.quote(str(it)), "name": shlex.quote(name)}
    following = [step.format(**quoted) for step in TEMPLATES[template].next]
    echo(*map(str, paths), before="written: ")
    echo(f"next:    {following[0]}")
    echo(*following[1:], before="         ")
    return CommandResult({"template": template, "files": paths, "next": following})


@command
def explain(
    key: Annotated[str | None, typer.Argument(autocompletion=words)] = None, reference: bool = False
) -> CommandResult:
    """Explain a key, a value, a table or an effect of any file, or a topic.

    Meaning, unit, bounds, default, and the files it may stand in, from the records that the files are read as. Of a
    topic its page, in Markdown; where a topic has the name of a key, the page follows what is told of the key.

    Args:
        key: a key, a value, a table or an effect, such as width_m, lag, servovalve or sensor_lag, or a topic such as
            proofs; without it all are listed.
        reference: print all keys as Markdown.
    """
    from dataclasses import asdict

    from beamdesign import docs
    from beamdesign.docs import effect_named, effects, find, keys, nearest, pages, topics
    from beamdesign.structure.materials import material_lines, material_names

    if key is None:
        everything = {"keys": [asdict(each) for each in keys()], "effects": [asdict(e) for e in effects()]}
        if reference:
            echo(docs.reference_markdown())
        else:
            _list()
        return CommandResult(everything | {"topics": topics()})
    if reference:
        refuse("explain", ("--reference", "prints all keys; leave KEY away"))
    wanted = docs.plain(key)
    effect = effect_named(wanted)
    materials = [name for name in material_names() if wanted in (name, "material")]
    some = [] if effect else list(find("outer_beam.material" if wanted in materials else wanted))
    every = effects() if wanted == "effects" else (effect,) if effect else ()
    text, valued = pages().get(wanted), docs.with_value(wanted)
    if not (some or every or valued or text):
        close = nearest(wanted)
        hint = f"did you mean {' or '.join(close)}?" if close else "`beamdesign explain` lists all"
        refuse("explain", (key or "''", f"unknown key; {hint}"))
    if effect:
        echo("\n".join(docs.effect_lines(effect)))
    elif some:
        echo("\n\n".join("\n".join(docs.key_lines(group)) for group in docs.alike(some)))
        if materials:
            echo("", "known materials:", *material_lines(materials))
        for one in every:
            echo(f"\n{one.name} ({one.subsystem})\n  {one.meaning}")
    if valued:
        echo(*([""] if some or every else []), *docs.value_lines(wanted, valued))
    if text is not None:
        echo(f"\n{text}".rstrip() if some or valued else text.rstrip())
    fields = {"keys": [asdict(each) for each in (*some, *valued)], "effects": [asdict(e) for e in every if e]}
    return CommandResult({"key": key, **fields, "page": text})


def _list() -> None:
    """All keys by file and table, effects and topics, as they would be asked for."""
    from itertools import groupby

    from beamdesign.docs import effects, keys, topics

    plain = [key for key in keys() if not key.path.startswith("effects.")]
    for file, of_file in groupby(plain, lambda key: key.file):
        echo(f"{file}:")
        for table, inside in groupby(
            sorted((key for key in of_file if not key.is_table), key=lambda key: key.path.rpartition(".")[0]),
            lambda key: key.path.rpartition(".")[0],
        ):
            names = dict.fromkeys(key.name for key in inside)
            echo(f"  {f'[{table}]' if table else '(top)'} {', '.join(names)}")
    echo("effects:")
    for effect in effects():
        echo(f"  [effects.{effect.name}] {', '.join(q.name for q in effect.parameters)}")
    echo("topics:")
    for topic, title in topics().items():
        echo(f"  {topic}: {title.partition(': ')[2] or title}")
    echo("\nbeamdesign explain KEY tells more of any of these.")


@command
def paper(out: Path, figure: Annotated[int | None, typer.Option(metavar="N")] = None) -> CommandResult:
    """Recompute the numbers of Zalucky and Hardt (1984).

    Every number and the figures 8 to 16, the paper's beside the model's; where they disagree, why. What the paper says
    about each figure is checked; --figure N does that for one of them.

    Args:
        out: folder for paper.html, paper.json and figures.
        figure: draw this figure of the paper alone, 8 to 16.
    """
    if figure is not None:
        return _one_figure(figure, out)
    from beamdesign.validation.paper_comparison import CHOICES, write_page

    comparison = beamdesign.paper()
    with progress("drawing") as update, fresh_folder(out) as fresh:
        page, figures, checks = write_page(comparison, fresh, update)
        drawn = {"report": page.name, "figures": [path.name for path in figures], "figure_claims": checks}
        fields = comparison.to_dict() | drawn
        write_json(fresh / "paper.json", fields)

    echo("Two choices the paper leaves open:")
    for number, choice in enumerate(CHOICES, 1):
        echo(f"  {number}. {choice}")
    echo_table(
        "Critical gain, mA/V",
        ["case", "paper, predicted", "paper, measured", "model", "with 400 Hz filter", "and smaller side"],
        [
            (
                row.case.name, row.case.predicted_mA_per_V, row.case.measured_mA_per_V, row.model_mA_per_V,
                row.varied_mA_per_V["with_filter"], row.varied_mA_per_V["filter_and_smaller_side"],
            )
            for row in comparison.gains
        ],
    )  # fmt: skip
    rows = [(row.case, row.gain_mA_per_V, row.paper, row.model) for row in comparison.bandwidths]
    echo_table("Bandwidth at -100 dB in/lbf, Hz", ["case", "gain, mA/V", "paper", "model"], rows)
    differing = [row for row, claim in zip(comparison.rows(), comparison.claims, strict=True) if not claim.agrees]
    title = f"{len(differing)} of {len(comparison.claims)} numbers differ"
    echo_table(title, ["quantity", "paper", "model", "unit", "verdict"], differing)
    _echo_checks(checks)
    echo(f"{len(comparison.slips)} slips of the paper, the reasons and the figures: {out / page.name}")
    return CommandResult(fields)


def _one_figure(number: int, out: Path) -> CommandResult:
    from beamdesign.validation.paper_figures import NUMBERED

    if number not in NUMBERED:
        refuse("--figure", (str(number), f"not drawn here; there are {min(NUMBERED)} to {max(NUMBERED)}"))
    drawing = NUMBERED[number]()
    files = write_drawn(out, drawing.name, drawing.figure)
    echo(drawing.title)
    echo(f"paper: {drawing.claim}")
    echo(f"model: {drawing.caption}")
    _echo_checks(drawing.checks)
    return CommandResult({"figure": number, "title": drawing.title, "figures": files, "claims": drawing.checks})


def _echo_checks(checks: Sequence[Any]) -> None:
    failing = sum(not check.holds for check in checks)
    title = f"{len(checks) - failing} of {len(checks)} claims about the figures hold"
    rows = [(check.figure, check.claim, check.paper, check.model, "yes" if check.holds else "no") for check in checks]
    echo_table(title, ["figure", "claim", "paper says", "model says", "holds"], rows)
