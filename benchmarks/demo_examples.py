"""The examples of `totalediting demo`: synthetic people and lights, small.

    python benchmarks/demo_examples.py --person DIR:KEY … --motion DIR:KEY … --light ENV.exr … \
        --out totalediting/demo/examples
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image

from assets_procedural.conventions import panorama_files, panorama_reading
from totalediting.editing.sources import read_photograph

SIDE, QUALITY = 448, 85
LIGHT_WIDTH = 192


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", type=Path, nargs="+", default=[])
    parser.add_argument("--motion", type=Path, nargs="+", default=[])
    parser.add_argument("--light", type=Path, nargs="+", default=[])
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for kind in ("person", "motion"):
        for number, source in enumerate(getattr(arguments, kind)):
            picture = Image.fromarray(read_photograph(source).picture)
            picture.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
            target = arguments.out / f"{kind}_{number}.jpg"
            picture.save(target, quality=QUALITY, optimize=True)
            print(target, target.stat().st_size)
    for source in arguments.light:
        target = arguments.out / f"light_{source.stem}.exr"
        panorama_files.write(target, panorama_reading.load(source, LIGHT_WIDTH), {})
        print(target, target.stat().st_size)


if __name__ == "__main__":
    main()
