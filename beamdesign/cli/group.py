"""The manner of all commands together: what `--quiet` and an interruption mean, and the order of the help."""

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from beamdesign.cli.interruption import remembered
from beamdesign.cli.output import hush, reporting, say, speak

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it: 128 and the number of the signal."""


HEADINGS = ("Begin", "Design", "Prove", "Build", "Simulate", "Compare with a rig", "Source")
"""Of the help, in the order of a newcomer's way."""


class Commands(TyperGroup):
    """The commands of the program.

    Options of the program itself are accepted after the name of a command as well, which is where people type them.
    """

    def __init__(self, **attributes: Any):
        super().__init__(**attributes)
        own = [parameter for parameter in self.params if parameter.name == "quiet"]
        _extend(self, own)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the program's own options; what an earlier call in this process said is forgotten."""
        speak()
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under their headings."""
        panels: dict[str, list[tuple[str, str]]] = {}
        commands = [(name, self.commands[name]) for name in self.list_commands(ctx) if not self.commands[name].hidden]
        width = max(len(name) for name, _ in commands)
        for name, command in commands:
            heading = getattr(command, "rich_help_panel", None)
            heading = heading if isinstance(heading, str) else "Further commands"
            words = command.get_short_help_str(formatter.width - 6 - width)
            panels.setdefault(heading, []).append((name.ljust(width), words))
        for heading, rows in sorted(panels.items(), key=lambda panel: (*HEADINGS, panel[0]).index(panel[0])):
            with formatter.section(heading):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; from the keyboard it can be interrupted, which takes one line and no traceback."""
        try:
            with remembered(), reporting(f"{ctx.info_name} {ctx.invoked_subcommand or ''}".strip()):
                return super().invoke(ctx)
        except KeyboardInterrupt:
            say_interrupted(f"{ctx.info_name} {ctx.invoked_subcommand or ''}".strip())
            raise typer.Exit(INTERRUPTED) from None

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **extra: Any) -> Any:
        """Read the command line; a part of the program is loaded for it, which can be interrupted as well."""
        try:
            return super().make_context(info_name, args, *rest, **extra)
        except KeyboardInterrupt:
            say_interrupted(info_name or "beamdesign")
            raise typer.Exit(INTERRUPTED) from None


def say_interrupted(name: str) -> None:
    """One line on stderr; where that is a terminal it takes the place of the ^C."""
    print(f"{chr(13) if sys.stderr.isatty() else ''}{name}: interrupted", file=sys.stderr)


def _extend(group: Any, parameters: list[Any]) -> None:
    for command in getattr(group, "commands", {}).values():
        command.params.extend(parameters)
        _extend(command, parameters)


def _hear(quiet: bool) -> None:
    if quiet:
        hush()


def _tell_version(asked: bool) -> None:
    if asked:
        import beamdesign

        say(f"beamdesign {beamdesign.__version__}")
        raise typer.Exit


def program(
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet", "-q", callback=_hear, is_eager=True, expose_value=False, help="Print nothing but errors."
        ),
    ] = False,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_tell_version, is_eager=True, expose_value=False, help="Print the version."),
    ] = False,
) -> None:
    """The program's own options; `Commands` gives the first to every command too; its help is that of the app."""
