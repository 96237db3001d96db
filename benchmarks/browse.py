"""How fast `synthgen browse` answers over a manifest of two million frames.

    python benchmarks/browse.py [--folder DIR] [--frames 2000000] [--rounds 9]

Makes a synthetic manifest in DIR (kept there; without DIR in a temporary folder): one subset of ten
views under two environments, as render_jobs/multiview.toml has it, so half as many rows as frames,
with every column and the spread of values of a real one. Then starts the server as a user does and
asks it over HTTP, each time something that it was not asked before. Prints a table of
milliseconds, median and worst. "At once" is right after the start, before the manifest is in
memory.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import re
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import duckdb
import report

from synthgen.dataset.columns import schema

VIEWS, LIGHTS = 10, 2
ENVIRONMENTS = [f"sky_{i:04d}" for i in range(40)] + [f"studio_{i:04d}" for i in range(20)]
QUALITY = (
    *("contrast_min", "depth_max", "depth_min", "landmark_depth", "landmark_pixels"),
    *("landmarks_inside", "landmarks_visible", "level_max", "level_min", "mask_fraction"),
    *("mask_overlap", "normal_angle", "normal_length"),
)
COST = ("beauty", "build", "develop", "labels", "pose", "store", "subject")
# Columns that a page counts when it is opened.
FIRST = ("subset", "kind", "split", "index", "pose", "view", "failed", "environments")
STYLES = ["short", "bob", "curly", "ponytail", "long_wavy", "bald", "afro", "buzz", "bun"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="where the manifest is made, and kept")
    parser.add_argument("--frames", type=int, default=2_000_000)
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary) / "manifest"
        if not (folder / "dataset.json").exists():
            make(folder, arguments.frames // LIGHTS)
        measure(folder, arguments.rounds)


# ---------------------------------------------------------------- the manifest


def make(folder: Path, rows: int) -> None:
    """A complete dataset of `rows` shots without any shards: dataset.json and the manifest."""
    (folder / "manifest").mkdir(parents=True)
    columns = ", ".join(f'{value(n, k)} AS "{n}"' for n, k in schema(QUALITY, COST).items())
    target = folder / "manifest" / "multiview.parquet"
    with duckdb.connect() as connection:
        connection.execute("SET threads = 2")
        connection.execute("SELECT setseed(0.5)")
        connection.execute(
            f"COPY (SELECT {columns} FROM range({rows}) AS t(i)) TO '{target}' "
            "(FORMAT parquet, COMPRESSION zstd, ROW_GROUP_SIZE 20000)"
        )
    subjects = rows // VIEWS
    plan = {"kind": "multiview", "subjects": subjects, "shots_per_subject": VIEWS}
    plan["frames_per_subject"] = VIEWS * LIGHTS
    environments = [{"id": e, "kind": e.split("_")[0]} for e in ENVIRONMENTS]
    info = {"format": 1, "name": "synthetic", "complete": True, "plan": {"multiview": plan}}
    info["environments"] = environments
    (folder / "dataset.json").write_text(json.dumps(info), encoding="utf-8")


def value(name: str, kind: str) -> str:
    """An SQL expression of a column's value in row `i`, spread as renders spread it."""
    subject = f"(i // {VIEWS})"
    key = f"'s' || lpad({subject}::VARCHAR, 6, '0')"

    def one_of(names: list[str]) -> str:
        return f"{names}[1 + (hash({subject}, '{name}') % {len(names)})::BIGINT]"

    fixed = {
        "key": f"{key} || '_p' || lpad((i % {VIEWS})::VARCHAR, 2, '0')",
        "subject": key,
        "subset": "'multiview'",
        "kind": "'multiview'",
        "split": f"CASE WHEN hash({subject}) % 20 > 1 THEN 'train' "
        f"WHEN hash({subject}) % 20 = 1 THEN 'validation' ELSE 'test' END",
        "index": subject,
        "view": f"i % {VIEWS}",
        "pose": "0",
        "width": "512",
        "height": "512",
        "shard": "'data/multiview/train-' || lpad((i // 400)::VARCHAR, 6, '0') || '.tar'",
        "offset": "(i % 400) * 5000000",
        "size": "5000000",
        "members": "[{'name': 'rgb_00.png', 'offset': (i % 400) * 5000000 + 512, 'size': 400000}]",
        "mesh": f"'subjects/multiview/' || {key} || '.glb'",
        "mesh_sha256": f"sha256({subject}::VARCHAR)",
        "environments": f"[{one_of(ENVIRONMENTS)}, {one_of(ENVIRONMENTS[1:])}]",
        "person_hair_style": one_of(STYLES),
        "person_beard_style": one_of(["none", "none", "stubble", "goatee", "full"]),
        "person_age_years": f"round(18 + (hash({subject}, 'age') % 6700) / 100, 1)",
    }
    if name in fixed:
        return f"({fixed[name]})::{kind}"
    if kind == "VARCHAR":
        return f"CASE WHEN hash({subject}, '{name}') % 5 > 2 THEN {one_of(['a', 'b', 'c'])} END"
    if kind == "BOOLEAN":
        return "random() < 0.5"
    if kind == "BIGINT":
        return "(random() * 4e9)::BIGINT"
    if kind.endswith("[]"):
        return f"[round(random(), 4), round(random(), 4)]::{kind}"
    if kind.startswith("MAP"):
        return "MAP {'chin-width-incr': round(random(), 4), 'nose-trans-up': round(random(), 4)}"
    if name.startswith("expression_"):
        return "greatest(0, round(random() * 2 - 1, 4))"
    return "round(random() * 2 - 1, 4)"


# ---------------------------------------------------------------- the server


class Server:
    """`synthgen browse` over a folder, in a process of its own."""

    def __init__(self, folder: Path) -> None:
        code = "from synthgen.cli import main; main()"
        command = [sys.executable, "-c", code, "browse", str(folder), "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        found = re.search(r"http://\S+", self.process.stdout.readline())
        assert found, "the server did not start"
        self.address = found.group()

    def ask(self, path: str, **query: Any) -> Any:
        """The JSON of an address; values that are no text are sent as JSON."""
        texts = {k: v if isinstance(v, str) else json.dumps(v) for k, v in query.items()}
        url = f"{self.address}{path}?{urllib.parse.urlencode(texts)}"
        with urllib.request.urlopen(url) as answer:
            return json.load(answer)

    def close(self) -> None:
        self.process.terminate()
        self.process.wait()


def measure(folder: Path, rounds: int) -> None:
    """Print the table."""
    start = time.perf_counter()
    server = Server(folder)
    try:
        started = time.perf_counter() - start
        early = times(1, lambda _: first_page(server))
        counted = times(1, lambda _: server.ask("api/counts", columns=",".join(FIRST)))
        hasty = times(1, lambda _: filtered(server, FIRST, ranges={"camera_yaw": [0.1, None]}))
        while not server.ask("api/dataset")["ready"]:
            time.sleep(0.2)
        loaded = time.perf_counter() - start
        columns = server.ask("api/dataset")["columns"]
        ranges = [c["name"] for c in columns if c["kind"] == "range"]
        print(f"The server listens after {started:.1f} s, the manifest is in memory after ", end="")
        held = report.resident(server.process.pid) / 1e3
        print(f"{loaded:.1f} s, in which {held:.1f} GB are resident.\n")
        first = {
            "first page, at once": early,
            "first counts, at once": counted,
            "a first filter with its counts, at once": hasty,
        }
        timed = itertools.chain(first.items(), later(server, ranges, rounds))
        report.table(
            ["what", "median, ms", "worst, ms"],
            (
                [name, f"{statistics.median(found):.0f}", f"{max(found):.0f}"]
                for name, found in timed
            ),
        )
    finally:
        server.close()


def later(server: Server, ranges: list[str], rounds: int) -> Iterator[tuple[str, list[float]]]:
    """What is asked once the manifest is in memory, and the milliseconds of each round."""
    yield ("first counts of every column", times(1, lambda _: server.ask("api/counts")))
    yield ("first page", times(rounds, lambda _: first_page(server)))
    rng = random.Random(0)
    makers = {
        "a range": lambda: {"ranges": {rng.choice(ranges): [rng.uniform(-0.5, 0), None]}},
        "three ranges": lambda: {
            "ranges": {n: [rng.uniform(-0.9, 0), 0.9] for n in rng.sample(ranges, 3)}
        },
        "a facet": lambda: {"facets": {"person_hair_style": rng.sample(STYLES, 2)}},
        "an environment": lambda: {"facets": {"environments": rng.sample(ENVIRONMENTS, 2)}},
        "SQL": lambda: {"where": f"camera_yaw > {rng.uniform(-0.9, 0)} AND head_yaw < 0.3"},
    }
    for name, make_one in makers.items():
        asked = [make_one() for _ in range(rounds)]
        yield (f"rows under {name}", times(rounds, lambda i, a=asked: rows(server, **a[i])))
        asked = [make_one() for _ in range(rounds)]
        yield (
            f"rows and counts under {name}",
            times(rounds, lambda i, a=asked: filtered(server, FIRST, **a[i])),
        )
    order = rng.sample(ranges, min(rounds, len(ranges)))
    yield ("rows sorted by a number", times(len(order), lambda i: rows(server, sort=order[i])))
    yield ("rows sorted by a text", times(rounds, lambda _: rows(server, sort="person_hair_style")))
    places = [rng.randrange(server.ask("api/dataset")["shots"]) for _ in range(rounds)]
    yield ("rows far down", times(rounds, lambda i: rows(server, offset=places[i])))
    yield (
        "rows far down, sorted",
        times(rounds, lambda i: rows(server, offset=places[i], sort=order[i % len(order)])),
    )
    yield ("counts of every column", times(3, lambda i: everything(server, i)))


def first_page(server: Server) -> None:
    server.ask("api/dataset")
    rows(server)


def rows(server: Server, **query: Any) -> None:
    server.ask("api/shots", **({"limit": 60} | query))


def filtered(server: Server, columns: tuple[str, ...], **query: Any) -> None:
    rows(server, **query)
    server.ask("api/counts", columns=",".join(columns), **query)


def everything(server: Server, i: int) -> None:
    server.ask("api/counts", ranges={"camera_yaw": [-0.9 + 0.01 * i, None]})


def times(rounds: int, ask: Any) -> list[float]:
    """Milliseconds of each of the rounds."""
    found = []
    for i in range(rounds):
        with report.clock() as took:
            ask(i)
        found.append(1000 * took.seconds)
    return found


if __name__ == "__main__":
    main()
