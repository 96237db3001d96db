"""What a few minutes of a GPU are good for: speed of every preset, then training at the largest.

    python benchmarks/accelerator.py DATASET --out RUN [--minutes 10] [--device cuda]

First `benchmarks/training.py` measures a step of `reconstruct` for every preset, plainly and with
torch.compile, as far as a third of the time goes; what does not fit in memory is said. Then the
largest preset that fits trains in RUN for what is left, plainly, and is evaluated. The table is
also in RUN/accelerator.md; RUN is a run like any other.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import report
import torch
from training import Found, alone, machine

from totalediting.errors import InputError
from totalediting.presets import PRESETS
from totalediting.training.stages import STAGES

STAGE = "reconstruct"
STEPS = 5  # that are timed
MEASURING = 1 / 3  # of the time, at most
TRAINING = 0.85  # of what is left: evaluation takes the rest
HEADER = ["preset", "torch.compile", "batch", "s a step", "samples a s", "peak memory, MB"]


def cells(found: Found | str, batch: int) -> list[str]:
    """A step's cells of the table, or why there are none."""
    if isinstance(found, str):
        return [found, "", ""]
    return [f"{found.step:.3f}", f"{batch / found.step:.1f}", f"{found.memory:,.0f}"]


def speeds(
    data: Path, device: str, batch: int, until: float
) -> tuple[list[list[str]], dict[str, float]]:
    """Rows of the table, and the seconds of a plain step by preset, the largest last."""
    rows: list[list[str]] = []
    plain: dict[str, float] = {}
    for compiled in (False, True):
        for preset in PRESETS if not compiled else list(plain):
            row = [preset, "yes" if compiled else "no", str(batch)]
            if time.monotonic() > until and plain:
                rows.append([*row, *cells("no time left", batch)])
                continue
            print(f"measuring {preset}{', compiled' if compiled else ''} …", file=sys.stderr)
            try:
                found = alone(STAGE, data, preset, batch, STEPS, device, compiled)
            except Exception as error:  # one preset that fails leaves the others
                found = (str(error).strip().splitlines() or [type(error).__name__])[0]
            if isinstance(found, Found) and not compiled:
                plain[preset] = found.step
            rows.append([*row, *cells(found, batch)])
    return rows, plain


def benchmark(options: argparse.Namespace) -> None:
    if options.minutes <= 0:
        raise InputError(f"--minutes: {options.minutes:g}: give a positive number")
    if options.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device: cuda: PyTorch finds no CUDA device here; use --device cpu")
    start = time.monotonic()
    end = start + 60 * options.minutes
    batch = options.batch or STAGES[STAGE].schedule.batch
    until = start + MEASURING * (end - start)
    rows, plain = speeds(options.data, options.device, batch, until)
    report.table(HEADER, rows)
    options.out.mkdir(parents=True, exist_ok=True)
    lines = [machine(options.device), "", " | ".join(HEADER), " | ".join("---" for _ in HEADER)]
    lines += [" | ".join(row) for row in rows]
    (options.out / "accelerator.md").write_text("\n".join(lines) + "\n")
    if not plain:
        raise InputError(f"--batch: {batch}: no preset can be trained here; give fewer")

    preset, step = list(plain.items())[-1]
    steps = max(int(TRAINING * (end - time.monotonic()) / step), 1)
    print(f"\ntraining {preset}, {steps} steps of {batch}", flush=True)
    command = [sys.executable, "-m", "totalediting"]
    train = ["train", STAGE, str(options.data), "--out", str(options.out), "--preset", preset]
    train += ["--steps", str(steps), "--batch", str(batch), "--device", options.device]
    for arguments in (train, ["evaluate", str(options.out), str(options.data)]):
        subprocess.run([*command, *arguments], check=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, metavar="DATASET")
    parser.add_argument("--out", type=Path, required=True, metavar="RUN")
    parser.add_argument("--minutes", type=float, default=10.0, help="in all")
    parser.add_argument("--batch", type=int, help="default: the stage's own")
    parser.add_argument("--device", default="cuda", choices=("cpu", "cuda"))
    try:
        benchmark(parser.parse_args())
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        return error.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
