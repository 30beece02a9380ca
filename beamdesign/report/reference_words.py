"""The reference of keys as text: what is told of one word, all words by table, and the Markdown of page `reference`."""

from collections.abc import Iterable, Iterator
from itertools import groupby

from beamdesign.report.reference import EffectEntry, Key, effects, keys


def places(alike: Iterable[Key]) -> str:
    """Where keys that are the same in all but their place may stand."""
    by_file: dict[str, list[str]] = {}
    for key in alike:
        by_file.setdefault(key.file, []).append(key.path)
    paths = list(dict.fromkeys(tuple(paths) for paths in by_file.values()))
    told = []
    for each in paths:
        files = [file for file, own in by_file.items() if tuple(own) == each]
        told.append(f"{', '.join(each)} ({', '.join(files)})")
    return "; ".join(told)


def alike(found: Iterable[Key]) -> list[list[Key]]:
    """Keys gathered by what is told of them, in order of first appearance."""
    groups: dict[tuple[object, ...], list[Key]] = {}
    for key in found:
        groups.setdefault(key.facts, []).append(key)
    return list(groups.values())


def value_words(key: Key) -> str:
    """Type, unit and bounds of what may stand there."""
    words = key.kind
    if key.unit:
        words += " without unit" if key.unit == "1" else f" in {key.unit}"
    return words + (f", {key.bounds}" if key.bounds else "")


def key_lines(group: list[Key]) -> Iterator[str]:
    """What there is to say of one key (or of several that are alike)."""
    key = group[0]
    yield key.name if not key.is_table else f"[{key.name}]"
    yield f"  {key.meaning}"
    yield f"  value:   {value_words(key)}"
    yield f"  default: {key.default}"
    if key.only_for:
        yield f"  only in: tables of kind {', '.join(key.only_for)}"
    yield f"  stands:  {places(group)}"
    if key.source:
        yield f"  source:  {key.source}"


def effect_lines(effect: EffectEntry) -> Iterator[str]:
    """What there is to say of an effect, its parameters included."""
    yield f"[effects.{effect.name}]"
    yield f"  {effect.meaning}"
    yield f"  subsystem: {effect.subsystem}"
    yield f"  stands:    in the prototype of {' and of '.join(effect.rigs)}"
    yield f"  source:    {effect.source}"
    yield f"  in proofs: {effect.linear or 'nothing stands for it'}"
    if effect.leaves_out:
        yield f"             not covered: {effect.leaves_out}"
    for q in effect.parameters:
        yield f"  {q.name} = {q.default}"
        yield f"      {q.meaning}; {value_words(q)}"


def reference_markdown() -> str:
    """All keys and effects as Markdown: one table per kind of file, what was told before not repeated."""
    out = ["`beamdesign explain KEY` tells the same of one key, table or effect.", ""]
    told: set[tuple[object, ...]] = set()
    for file, group in groupby((key for key in keys() if not key.path.startswith("effects.")), lambda key: key.file):
        summary = f"<details><summary>Keys of a {file}</summary>"
        out += [summary, "", "| key | meaning | value | default |", "|---|---|---|---|"]
        own = list(group)
        tables: dict[tuple[tuple[object, ...], ...], list[str]] = {}
        for table in dict.fromkeys(key.path.rpartition(".")[0] for key in own):
            inside = [key for key in own if key.path.rpartition(".")[0] == table and not key.is_table]
            tables.setdefault(tuple(key.facts for key in inside), []).append(table)
        for facts, names in tables.items():
            if not facts:
                continue
            heading = ", ".join(f"`[{name}]`" for name in names if name)
            if facts in told:
                out.append(f"| {heading} | as above | | |")
                continue
            told.add(facts)
            first = [key for key in own if key.path.rpartition(".")[0] == names[0] and not key.is_table]
            if heading:
                out.append(f"| {heading} | *{_cell(_about(own, names[0]))}* | | |")
            out += [_row(key) for key in first]
        out += ["", "</details>", ""]
    summary = "<details><summary>Effects of a prototype and their figures</summary>"
    out += [summary, "", "| effect and its figures | meaning | value | default |", "|---|---|---|---|"]
    for effect in effects():
        out.append(f"| `[effects.{effect.name}]` | *{_cell(effect.meaning.split('. ')[0].rstrip('.'))}* | | |")
        out += [_row(key) for key in effect.parameters]
    return "\n".join([*out, "", "</details>"]) + "\n"


def _about(of_file: Iterable[Key], table: str) -> str:
    return next((key.meaning for key in of_file if key.path == table.removesuffix(".NAME")), "")


def _row(key: Key) -> str:
    value = value_words(key).removeprefix("a number").strip(" ,")
    value = value.removeprefix("in ").replace(" without unit", "").removeprefix("without unit").strip(" ,")
    only = f" ({', '.join(key.only_for)})" if key.only_for else ""
    default = "" if key.default == "none" else key.default
    return f"| `{key.name}` | {_cell(key.meaning)}{only} | {_cell(value)} | {_cell(default)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
