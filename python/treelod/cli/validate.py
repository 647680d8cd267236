"""``treelod validate``: pictures and bakes against mitsuba, embree and trimesh."""

from __future__ import annotations

from typing import Annotated

import typer

from treelod.cli.app import app
from treelod.cli.options import PlantName, ReportFolder, Verbose
from treelod.cli.subjects import subject_of
from treelod.terminal import Stages, reported


@app.command()
def validate(
    *,
    plant: PlantName,
    output: ReportFolder,
    full: Annotated[
        bool, typer.Option("--full", help="Everything at full size: minutes, not seconds.")
    ] = False,
    verbose: Verbose = False,
) -> None:
    r"""
    Check pictures and bakes of a plant against mitsuba, embree and trimesh.

    The report is OUTPUT/validation.html; exit code 1 if a check fails.
    Needs mitsuba and embree: pip install 'treelod\[validate]'.
    """
    with reported(verbose=verbose), Stages() as stages:
        from treelod import references
        from treelod.report import check_folder
        from treelod.report.validation import write_validation

        check_folder(output)
        references.require()
        subject, source = subject_of(stages, plant)
        found = references.validate(subject, full=full, source=source, progress=stages)
        page = write_validation(found, output)
    for section in found.sections:
        for check in section.checks:
            if not check.passed:
                typer.echo(
                    f"failed: {section.title}: {check.name}: "
                    f"{check.value:.6g}, not {check.relation} {check.limit:g}"
                )
    count = sum(len(section.checks) for section in found.sections)
    typer.echo(f"{found.plant}: {count} checks {'passed' if found.passed else 'made'}")
    typer.echo(f"report: {page}")
    if not found.passed:
        raise typer.Exit(1)
