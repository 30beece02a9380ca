"""`beamdesign explain`: what a key of a file means, and pages on the parts of the tool."""

from typing import Annotated

import typer

from beamdesign.cli.completion import words
from beamdesign.cli.output import JsonOption, say, write_json


def explain(
    key: Annotated[
        str | None,
        typer.Argument(
            help="A key, a table or an effect, such as width_m, servovalve or sensor_lag, or a topic such as proofs; "
            "without it all are listed.",
            autocompletion=words,
        ),
    ] = None,
    reference: Annotated[bool, typer.Option("--reference", help="Print all keys as Markdown.")] = False,
    json: JsonOption = None,
) -> None:
    """Explain a key, a table or an effect of any file, or a topic.

    Meaning, unit, bounds, default, and the files it may stand in, from the records that the files are read as. Of a
    topic its page, in Markdown; where a topic has the name of a key, the page follows what is told of the key.
    """
    from dataclasses import asdict

    from beamdesign.docs import page, topics
    from beamdesign.records import InputError
    from beamdesign.report import reference_words as told
    from beamdesign.report.reference import effect_named, effects, find, keys, nearest

    if key is None:
        everything = {"keys": [asdict(each) for each in keys()], "effects": [asdict(e) for e in effects()]}
        write_json(json, everything | {"topics": topics()})
        if reference:
            say(told.reference_markdown())
        else:
            _list()
        return
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
        say("\n".join(told.effect_lines(effect)))
    elif some:
        say("\n\n".join("\n".join(told.key_lines(group)) for group in told.alike(some)))
        for one in every:
            say(f"\n{one.name} ({one.subsystem})\n  {one.meaning}")
    if text is not None:
        say(f"\n{text}".rstrip() if some else text.rstrip())
    found = {"keys": [asdict(each) for each in some], "effects": [asdict(e) for e in every if e], "page": text}
    write_json(json, {"key": key} | found)


def _list() -> None:
    """All keys by file and table, effects and topics, as they would be asked for."""
    from itertools import groupby

    from beamdesign.docs import topics
    from beamdesign.report.reference import effects, keys

    plain = [key for key in keys() if not key.path.startswith("effects.")]
    for file, of_file in groupby(plain, lambda key: key.file):
        say(f"{file}:")
        for table, inside in groupby(
            sorted((key for key in of_file if not key.is_table), key=lambda key: key.path.rpartition(".")[0]),
            lambda key: key.path.rpartition(".")[0],
        ):
            names = dict.fromkeys(key.name for key in inside)
            say(f"  {f'[{table}]' if table else '(top)'} {', '.join(names)}")
    say("effects:")
    for effect in effects():
        say(f"  [effects.{effect.name}] {', '.join(q.name for q in effect.parameters)}")
    say("topics:")
    for topic, title in topics().items():
        say(f"  {topic}: {title.partition(': ')[2] or title}")
    say("\nbeamdesign explain KEY tells more of any of these.")
