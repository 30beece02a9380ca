"""`beamdesign new` and `explain`: commented files to start from, and what a key of a file means."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.command import CommandResult, command
from beamdesign.cli.output import echo, echo_table, path_to_write


def templates(incomplete: str) -> list[tuple[str, str]]:
    """Names of templates, each with what it is for, to complete a word with."""
    from beamdesign.templates import TEMPLATES

    return [(name, each.purpose) for name, each in TEMPLATES.items() if name.startswith(incomplete)]


def words(incomplete: str) -> list[str]:
    """Keys, tables, effects and topics that can be explained, to complete a word with."""
    from beamdesign.report.reference import keys, words

    known = sorted({key.path for key in keys()}) if "." in incomplete else words()
    return [word for word in known if word.startswith(incomplete)]


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

    from beamdesign.records import InputError
    from beamdesign.templates import TEMPLATES, start, target

    if template is None or listed:
        rows = [(name, each.purpose) for name, each in TEMPLATES.items()]
        echo_table("templates", ("name", "what it starts"), rows)
        echo("beamdesign new NAME --out FILE")
        return CommandResult({"templates": [{"name": name, "purpose": purpose} for name, purpose in rows]})
    if template not in TEMPLATES:
        close = difflib.get_close_matches(template, TEMPLATES, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(TEMPLATES)}"
        raise InputError("new", [(template or "''", f"no such template; {hint}")])
    paths = start(template, out)
    it = target(template, out)
    following = [step.format(it=shlex.quote(str(it)), name=shlex.quote(it.stem)) for step in TEMPLATES[template].next]
    for path in paths:
        echo(f"written: {path}")
    echo(f"next:    {following[0]}")
    for step in following[1:]:
        echo(f"         {step}")
    return CommandResult({"template": template, "files": paths, "next": following})


@command
def explain(
    key: Annotated[str | None, typer.Argument(autocompletion=words)] = None, reference: bool = False
) -> CommandResult:
    """Explain a key, a table or an effect of any file, or a topic.

    Meaning, unit, bounds, default, and the files it may stand in, from the records that the files are read as. Of a
    topic its page, in Markdown; where a topic has the name of a key, the page follows what is told of the key.

    Args:
        key: a key, a table or an effect, such as width_m, servovalve or sensor_lag, or a topic such as proofs; without
            it all are listed.
        reference: print all keys as Markdown.
    """
    from dataclasses import asdict

    from beamdesign.docs import page, topics
    from beamdesign.records import InputError
    from beamdesign.report import reference as told
    from beamdesign.report.reference import effect_named, effects, find, keys, nearest

    if key is None:
        everything = {"keys": [asdict(each) for each in keys()], "effects": [asdict(e) for e in effects()]}
        if reference:
            echo(told.reference_markdown())
        else:
            _list()
        return CommandResult(everything | {"topics": topics()})
    if reference:
        raise InputError("explain", [("--reference", "prints all keys; leave KEY away")])
    wanted = key.strip("[]")
    effect = effect_named(wanted)
    some = [] if effect else list(find(wanted))
    every = effects() if wanted == "effects" else (effect,) if effect else ()
    text = page(wanted) if wanted in topics() else None
    if not some and not every and text is None:
        close = nearest(wanted)
        hint = f"did you mean {' or '.join(close)}?" if close else "`beamdesign explain` lists all"
        raise InputError("explain", [(key or "''", f"unknown key; {hint}")])
    if effect:
        echo("\n".join(told.effect_lines(effect)))
    elif some:
        echo("\n\n".join("\n".join(told.key_lines(group)) for group in told.alike(some)))
        for one in every:
            echo(f"\n{one.name} ({one.subsystem})\n  {one.meaning}")
    if text is not None:
        echo(f"\n{text}".rstrip() if some else text.rstrip())
    found = {"keys": [asdict(each) for each in some], "effects": [asdict(e) for e in every if e], "page": text}
    return CommandResult({"key": key} | found)


def _list() -> None:
    """All keys by file and table, effects and topics, as they would be asked for."""
    from itertools import groupby

    from beamdesign.docs import topics
    from beamdesign.report.reference import effects, keys

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
