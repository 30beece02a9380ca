"""`beamdesign study`: sweeps over a study file, kept, resumed, shown and compared."""

import typer

from beamdesign.cli.study_diff import diff
from beamdesign.cli.study_run import run
from beamdesign.cli.study_show import show
from beamdesign.cli.study_status import status
from beamdesign.cli.study_why import why

study = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Sweep, sample or optimise over any key. Nothing is computed twice, and a killed run goes on.",
)
for command in (run, status, show, diff, why):
    study.command(command.__name__)(command)
