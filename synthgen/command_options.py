"""Arguments and options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from synthgen import farm

Dataset = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a dataset.")]
Device = Annotated[farm.Device, typer.Option(help="What Blender renders on.")]
Threads = Annotated[int, typer.Option(min=1, help="Threads per worker.")]
