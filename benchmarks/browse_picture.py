"""A picture of the page of `synthgen browse` over a dataset, for the README.

    python benchmarks/browse_picture.py DATASET PICTURE [--address '?sort=camera_yaw&descending=1']

Needs a Chromium, as `make test-browser` installs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--address", default="?sort=camera_yaw&descending=1")
    arguments = parser.parse_args()
    sys.path.insert(0, str(ROOT / "tests"))
    import page_driver

    with (
        tempfile.TemporaryDirectory() as folder,
        page_driver.chromium() as browser,
        page_driver.served(arguments.dataset.resolve(), Path(folder)) as address,
        page_driver.opened(browser, address.rstrip("/") + "/" + arguments.address) as page,
    ):
        page.locator(".cell.loaded").first.wait_for()
        page.wait_for_load_state("networkidle")
        page.screenshot(path=f"{folder}/page.png")
        with Image.open(f"{folder}/page.png") as picture:
            picture.convert("RGB").save(arguments.picture, quality=88)


if __name__ == "__main__":
    main()
