"""`beamdesign gap`: from records of a built rig back to the model."""

import typer

from beamdesign.cli.gap_blindcheck import blindcheck
from beamdesign.cli.gap_diagnose import diagnose
from beamdesign.cli.gap_predict import predict

gap = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Compare a built rig with its model. Where they differ, why, and how far the difference closes.",
)
for command in (diagnose, predict, blindcheck):
    gap.command(command.__name__)(command)
