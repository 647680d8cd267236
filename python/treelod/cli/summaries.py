"""The table of errors and costs that a command prints in the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from treelod.techniques import FullMesh

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["print_summary"]


def print_summary(title: str, summary: pd.DataFrame, samples: int) -> None:
    """Print errors and costs of each technique; times may be missing."""
    import pandas as pd

    from treelod.report.text import (
        NONE,
        decibels,
        error,
        millis,
        seconds,
        signed,
        size_bytes,
        times,
    )

    console = Console()
    # in a file or a pipe, lines are as long as the table needs
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(title=Text(title))
    table.add_column("technique", overflow="fold")
    # graphics cards tell their own times, most of them
    has_card_times = summary["gpu_millis"].notna().any()
    for name in (
        "frame ms",
        *(["card ms"] if has_card_times else []),
        "speed-up",
        "FLIP",
        "worst",
        "PSNR worst",
        "SSIM",
        "coverage bias",
        "size",
        "build",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for row in summary.to_dict("records"):
        label = str(row["label"])
        if label == FullMesh.name:
            label += f" ({samples} samples)"
        is_timed = pd.notna(row["frame_millis"])
        of_card = millis(row["gpu_millis"]) if pd.notna(row["gpu_millis"]) else NONE
        table.add_row(
            Text(label),
            millis(row["frame_millis"]) if is_timed else NONE,
            *([of_card] if has_card_times else []),
            times(row["speedup"]) if is_timed else NONE,
            error(row["flip"]),
            error(row["flip_worst"]),
            decibels(row["psnr_worst"]),
            error(row["ssim"]),
            signed(row["coverage_bias"]),
            size_bytes(row["total_bytes"]),
            seconds(row["build_secs"]),
        )
    console.print(table)
