"""The command line: one file per command, each importing its engine only when it runs."""

import sys
import traceback

import typer

from beamdesign.cli.arm import arm
from beamdesign.cli.certify import certify
from beamdesign.cli.certify_box import certify_box
from beamdesign.cli.certify_switching import certify_switching
from beamdesign.cli.code import code
from beamdesign.cli.codesign import codesign
from beamdesign.cli.encoding import write_in_any_encoding
from beamdesign.cli.explain import explain
from beamdesign.cli.front import front
from beamdesign.cli.gap import gap
from beamdesign.cli.group import INTERRUPTED, Commands, program, say_interrupted
from beamdesign.cli.limits import limits
from beamdesign.cli.new import new
from beamdesign.cli.output import shown
from beamdesign.cli.paper import paper
from beamdesign.cli.remedies import remedies
from beamdesign.cli.run import run
from beamdesign.cli.simulate import simulate
from beamdesign.cli.size import size
from beamdesign.cli.spec import spec
from beamdesign.cli.stiffness import stiffness
from beamdesign.cli.study import study
from beamdesign.cli.tune import tune

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,  # plain help: rich would cost a third of its time
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Design actively straightened robot links: sections, controller, end mass, and proofs that they hold.",
)
app.callback()(program)
PANELS = {
    "Begin": (new, explain),
    "Design": (run, size, tune, stiffness, codesign, front, remedies),
    "Prove": (certify, certify_box, certify_switching, arm),
    "Simulate": (simulate, limits),
    "Build": (spec, code),
    "Source": (paper,),
}
"""Commands by the heading of the help that they stand under."""
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
        say_interrupted("beamdesign")
        sys.exit(INTERRUPTED)
    except OSError as error:  # a full disk, a folder taken away: nothing that a traceback would explain
        print(shown(f"{error.filename or 'beamdesign'}: {error.strerror or error}"), file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        print(f"beamdesign: more memory is needed than there is: {error}".rstrip(": "), file=sys.stderr)
        sys.exit(2)
    except Exception as error:
        from beamdesign.records import InputError

        if isinstance(error, InputError):
            print(shown(str(error)), file=sys.stderr)
            sys.exit(2)
        print(shown(traceback.format_exc()), end="", file=sys.stderr)
        sys.exit(FAULT)  # not 1: a fault of the program is no answer
