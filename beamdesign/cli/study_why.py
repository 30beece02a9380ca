"""`beamdesign study why`: what governs one case of a sweep."""

from typing import Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, say, say_table, write_json


def why(
    case: Annotated[
        str, typer.Argument(metavar="CASE", help="DIR/NUMBER as `study show` numbers the rows, or DIR/ADDRESS.")
    ],
    json: JsonOption = None,
) -> None:
    """Tell why a case came out as it did.

    The structural checks with their utilisation, what binds, the shadow prices, and for a no what to relax; of loops
    the claims, the starts that failed and the scope of the proof. Exit status 1 if the case itself has no result.
    """
    from beamdesign.report.statements import price_words
    from beamdesign.study.governing import case_of, governing

    found = governing(case_of(case))
    record, details = found.record, found.record["details"]
    varied = ", ".join(f"{key} = {value}" for key, value in record["varied"].items()) or "base"
    say(f"{record['task']} of {varied}: {record['status']}{': ' + record['reason'] if record['reason'] else ''}")
    if found.checks:
        say_table(
            "structural checks, the most used first", ("check", "value", "", "limit", "unit", "used", ""), _rows(found)
        )
        say(f"binding: {'; '.join(found.binding) or 'none'}")
    if found.requirements:
        say(f"active at the lightest free sizes: {'; '.join(found.requirements)}")
    for sentence in price_words(found.shadow_prices) if found.shadow_prices else ():
        say(f"  {sentence}")
    for item in found.relaxations:
        say(f"  enough alone: {item['key']} from {item['asked']:g} to {item['enough']:.6g}")
    for name in ("scope", "failures", "attempts"):
        for line in details.get(name, ()):
            say(f"  {line}")
    for claim in details.get("claims", ()):
        say(f"  {'proved' if claim['holds'] else 'REFUTED'}: {claim['claim']} {claim['reason']}".rstrip())
    if "traceback" in details:
        say(details["traceback"].rstrip())
    if not details:
        say("  the task keeps no more than its outputs:")
        for name, value in record["outputs"].items():
            say(f"  {name}: {value}")
    write_json(json, {**found.__dict__, "outputs": record["outputs"]})
    if record["status"] != "done":
        raise typer.Exit(1)


def _rows(found: Any) -> list[tuple[Any, ...]]:
    return [
        (
            check["name"],
            check["value"],
            "at least" if check["at_least"] else "at most",
            check["limit"],
            check["unit"],
            "-" if check["utilisation"] is None else f"{100 * check['utilisation']:.0f} %",
            "" if check["satisfied"] else "FAILS",
        )
        for check in found.checks
    ]
