"""The command line: one file per command, each importing its engine only when it runs.

What commands have in common stands here: what `--quiet` and an interruption mean, the order of the help, and words on
terminals that cannot show every letter: what they lack is written with the letters that they have.
"""

import codecs
import sys
import traceback
import unicodedata
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import beamdesign
from beamdesign.cli.arm import arm, certify_switching
from beamdesign.cli.begin import explain, new, paper
from beamdesign.cli.certify import certify, certify_box
from beamdesign.cli.command import INTERRUPTED, group
from beamdesign.cli.design import codesign, front, remedies, run, size
from beamdesign.cli.gap import gap
from beamdesign.cli.output import echo, hush, shown, speak
from beamdesign.cli.rig import code, limits, spec
from beamdesign.cli.simulation import simulate
from beamdesign.cli.study import study
from beamdesign.cli.tune import stiffness, tune
from beamdesign.progress import remembered


class Commands(TyperGroup):
    """The commands of the program.

    Options of the program itself are accepted after the name of a command as well, which is where people type them.
    """

    def __init__(self, **attributes: Any):
        super().__init__(**attributes)
        _extend(self, [parameter for parameter in self.params if parameter.name == "quiet"])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the program's own options; what an earlier call in this process said is forgotten."""
        speak()
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under their headings."""
        panels: dict[str, list[tuple[str, str]]] = {}
        every: Any = self.commands
        commands = [(name, every[name]) for name in self.list_commands(ctx) if not every[name].hidden]
        width = max(len(name) for name, _ in commands)
        for name, command in commands:
            words = command.get_short_help_str(formatter.width - 6 - width)
            panels.setdefault(command.rich_help_panel, []).append((name.ljust(width), words))
        for heading, rows in sorted(panels.items(), key=lambda panel: [*PANELS].index(panel[0])):
            with formatter.section(heading):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; from the keyboard it can be interrupted, which takes one line and no traceback."""
        try:
            with remembered():
                return super().invoke(ctx)
        except KeyboardInterrupt:
            echo_interrupted(f"{ctx.info_name} {ctx.invoked_subcommand or ''}".strip())
            raise typer.Exit(INTERRUPTED) from None

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **extra: Any) -> Any:
        """Read the command line; a part of the program is loaded for it, which can be interrupted as well."""
        try:
            return super().make_context(info_name, args, *rest, **extra)
        except KeyboardInterrupt:
            echo_interrupted(info_name or "beamdesign")
            raise typer.Exit(INTERRUPTED) from None


def echo_interrupted(name: str) -> None:
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
        echo(f"beamdesign {beamdesign.__version__}")
        raise typer.Exit


_AT_ONCE: Any = {"is_eager": True, "expose_value": False}
"""Of an option that is done with when it has been read."""
_Quiet = Annotated[bool, typer.Option("--quiet", "-q", callback=_hear, help="Print nothing but errors.", **_AT_ONCE)]
_Version = Annotated[bool, typer.Option("--version", callback=_tell_version, help="Print the version.", **_AT_ONCE)]


def program(quiet: _Quiet = False, version: _Version = False) -> None:
    """The program's own options; `Commands` gives the first to every command too; its help is that of the app."""


_IN_ASCII = {
    "±": "+-", "µ": "u", "μ": "u", "×": "x", "·": "*", "°": " deg", "≤": "<=", "≥": ">=", "→": "->", "►": ">",
    "…": "...", "–": "-", "—": "-", "−": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "ß": "ss", "σ": "sigma",
    "ζ": "zeta", "Ω": "ohm",
}  # fmt: skip


def write_in_any_encoding() -> None:
    """Let standard output and error stand in for what their encoding lacks, instead of failing on it."""
    codecs.register_error("beamdesign.nearest", _nearest)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="beamdesign.nearest")


def _nearest(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    spelt = ""
    for letter in error.object[error.start : error.end]:  # each by its nearest in ASCII
        plain = "".join(c for c in unicodedata.normalize("NFKD", letter) if c.isascii())
        spelt += _IN_ASCII.get(letter) or plain or "?"
    return spelt, error.end


app = group(
    "Design actively straightened robot links: sections, controller, end mass, and proofs that they hold.",
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.callback()(program)
PANELS: dict[str, tuple[Callable[..., None], ...]] = {
    "Begin": (new, explain),
    "Design": (run, size, tune, stiffness, codesign, front, remedies),
    "Prove": (certify, certify_box, certify_switching, arm),
    "Build": (spec, code),
    "Simulate": (simulate, limits),
    "Compare with a rig": (),
    "Source": (paper,),
}
"""Commands by the heading of the help that they stand under, in the order of a newcomer's way."""
for panel, commands in PANELS.items():
    for command in commands:
        app.command(command.__name__.replace("_", "-"), rich_help_panel=panel)(command)
app.add_typer(gap, name="gap", rich_help_panel="Compare with a rig")
app.add_typer(study, name="study", rich_help_panel="Design")


FAULT = 3
"""Exit status where the program itself has failed."""


def main() -> None:
    """Run the command line; bad input ends with exit status 2 and one line per problem on stderr."""
    write_in_any_encoding()
    try:
        app()
    except KeyboardInterrupt:  # outside of any command
        echo_interrupted("beamdesign")
        sys.exit(INTERRUPTED)
    except Exception as error:
        from beamdesign.records import InputError

        status = 2
        if isinstance(error, OSError):  # a full disk, a folder taken away: nothing that a traceback would explain
            words = f"{error.filename or 'beamdesign'}: {error.strerror or error}"
        elif isinstance(error, MemoryError):
            words = f"beamdesign: more memory is needed than there is: {error}".rstrip(": ")
        elif isinstance(error, InputError):
            words = str(error)
        else:
            words, status = traceback.format_exc().rstrip(), FAULT  # not 1: a fault of the program is no answer
        print(shown(words), file=sys.stderr)
        sys.exit(status)
