"""The picture of `totalediting demo` in docs/editing.md, taken in Chromium.

    python benchmarks/demo_picture.py docs/demo.jpg

Needs the extras `demo` and `browser`, and Chromium.
"""

from __future__ import annotations

import argparse
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright  # pyright: ignore[reportMissingImports]

WIDTH, HEIGHT, QUALITY = 1280, 980, 82
PATIENCE = 120_000  # milliseconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path)
    arguments = parser.parse_args()
    code = "from totalediting.cli import main; main()"
    command = [sys.executable, "-u", "-c", code, "demo", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout
        found = re.search(r"http://\S+", server.stdout.readline())
        try:
            assert found
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=shutil.which("chromium"))
                page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
                page.set_default_timeout(PATIENCE)
                page.goto(found.group())
                before = ""
                for zone, example in (("appearance", 0), ("lighting", 2), ("motion", 0)):
                    page.locator(f"#{zone}_examples button").nth(example).click()
                    page.wait_for_function(
                        "s => (document.querySelector('#edited img')?.src ?? s) !== s", arg=before
                    )
                    before = page.locator("#edited img").get_attribute("src")
                page.locator("#take_apart").click()
                page.locator("#layers img").nth(3).wait_for()
                page.evaluate("window.scrollTo(0, 0)")
                page.wait_for_timeout(1000)
                shown = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
                shown.save(arguments.picture, quality=QUALITY, optimize=True)
                browser.close()
        finally:
            server.terminate()
    print(f"{arguments.picture}: {arguments.picture.stat().st_size / 1000:.0f} KB")


if __name__ == "__main__":
    main()
