"""`beamdesign new`: a commented file to start from."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.completion import templates
from beamdesign.cli.output import JsonOption, path_to_write, say, say_table, write_json


def new(
    template: Annotated[
        str | None, typer.Argument(help="What to start; without it all are listed.", autocompletion=templates)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            callback=path_to_write,
            help="The new file (folder, for a data set); else named after the template.",
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the templates.")] = False,
    json: JsonOption = None,
) -> None:
    """Start a study, a rig or a data set from a template.

    The file is commented, runs as it stands, and the command to run it with is printed. Nothing that exists is
    overwritten.
    """
    import difflib
    import shlex

    from beamdesign.records import InputError
    from beamdesign.templates import TEMPLATES, start, target

    if template is None or listed:
        rows = [(name, each.purpose) for name, each in TEMPLATES.items()]
        say_table("templates", ("name", "what it starts"), rows)
        say("beamdesign new NAME --out FILE")
        write_json(json, {"templates": [{"name": name, "purpose": purpose} for name, purpose in rows]})
        return
    if template not in TEMPLATES:
        close = difflib.get_close_matches(template, TEMPLATES, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(TEMPLATES)}"
        raise InputError("new", [(template or "''", f"no such template; {hint}")])
    paths = start(template, out)
    it = target(template, out)
    following = [step.format(it=shlex.quote(str(it)), name=shlex.quote(it.stem)) for step in TEMPLATES[template].next]
    for path in paths:
        say(f"written: {path}")
    say(f"next:    {following[0]}")
    for step in following[1:]:
        say(f"         {step}")
    write_json(json, {"template": template, "files": paths, "next": following})
