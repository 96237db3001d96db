"""Datasets and conditions made to do harm: does anything get out, in, on, or stuck?

    python benchmarks/torture_foreign.py [--kind NAME ...] [--seconds 30] [--limit 2]
        [--no-sql | --only-sql]

Every kind of hostile dataset goes through every command that reads one, through `open_dataset`,
training's `Shots` and the page's application, each in a process of its own with a limit of time and
memory, beside a folder that holds a secret. Counted are: files outside that were changed, made or
read; files of the dataset that were changed; tracebacks; runs that did not end; characters that a
terminal obeys. Then hostile conditions go through the page, `open_dataset` and `query`: escapes,
seconds beyond the limit, memory. Prints a line per finding, the counts, and ends with 1 if any.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import report
from hostile_datasets import KINDS, LINKS, SECRET, Place
from hostile_runs import CONTROLS, RUNS, age, in_child, make_place, run, state

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

import fake_renderer  # noqa: E402
from starlette.testclient import TestClient  # noqa: E402

from synthgen.browse.app import create  # noqa: E402
from synthgen.browse.folder import Folder  # noqa: E402
from synthgen.browse.shot.thumbnails import Thumbnails  # noqa: E402
from synthgen.browse.table import sandbox  # noqa: E402
from synthgen.browse.table.snapshot import Library  # noqa: E402
from synthgen.dataset import manifest, open_dataset  # noqa: E402
from synthgen.dataset.folder import StorageError  # noqa: E402
from synthgen.farm.local import render_job  # noqa: E402

HELD = 3000.0
"""Megabytes that a run may hold."""


def chosen(wanted: list[str]) -> dict[str, Callable[[Place], None]]:
    """Kinds whose names hold one of these, or all."""
    return {n: k for n, k in KINDS.items() if not wanted or any(w in n for w in wanted)}


def try_datasets(
    base: Path, work: Path, kinds: dict[str, Callable[[Place], None]], seconds: float
) -> tuple[list[str], int]:
    findings: list[str] = []
    runs, slowest, largest = 0, (0.0, ""), (0.0, "")
    for number, (name, spoil) in enumerate(kinds.items()):
        place = make_place(base, work / f"{number}", spoil)
        kept = (place.out, place.outside, place.root / "cwd", place.root / "tmp")
        after = state(*kept)
        for what, read in RUNS.items():
            before = after
            shutil.rmtree(place.target)
            place.target.mkdir()
            ages = age(place.outside)
            outcome = run(lambda read=read, place=place: read(place), place, seconds, kept[2])
            touched = [p.name for p, then in ages.items() if p.stat().st_atime_ns != then]
            runs += 1
            slowest = max(slowest, (outcome.seconds, f"{name}, {what}"))
            largest = max(largest, (outcome.megabytes, f"{name}, {what}"))
            found = []
            if outcome.stuck:
                found.append("does not end")
            if outcome.raised or "Traceback (most recent call last)" in outcome.said:
                found.append(f"traceback: {outcome.raised[:300]}")
            if (after := state(*kept)) != before:
                changed = [p for p in after | before if after.get(p) != before.get(p)]
                found.append(f"changes {changed[:3]}")
            read_outside = sorted({*touched, *outcome.opened})
            if read_outside and (name not in LINKS or what == "browse"):
                found.append(f"reads outside: {read_outside[:3]}")
            if SECRET.decode() in outcome.said or any(
                SECRET in p.read_bytes() for p in place.target.rglob("*") if p.is_file()
            ):
                found.append("tells the secret")
            if obeyed := CONTROLS & set(outcome.said):
                found.append(f"sends the terminal {sorted(obeyed)}")
            if outcome.megabytes > HELD:
                found.append(f"holds {outcome.megabytes:.0f} MB")
            findings += found
            for each in found:
                print(f"{name}: {what}: {each}".encode("unicode_escape").decode(), flush=True)
        shutil.rmtree(place.root)
    print(f"slowest: {slowest[0]:.1f} s, {slowest[1]}; largest: {largest[0]:.0f} MB, {largest[1]}")
    return findings, runs


CONDITIONS = (
    "true; COPY (SELECT 1) TO '{outside}/written'",
    "true); COPY (SELECT 1) TO '{outside}/written'; --",
    "true) UNION ALL SELECT content, 'a/b/c', 0, 0 FROM read_text('{outside}/secret.txt') --",
    "EXISTS (SELECT * FROM read_text('{outside}/secret.txt'))",
    "EXISTS (FROM read_blob('{outside}/secret.txt'))",
    "EXISTS (FROM read_csv('{outside}/secret.txt'))",
    "EXISTS (FROM '{outside}/secret.txt')",
    "EXISTS (FROM read_json('{outside}/secret.txt'))",
    "EXISTS (FROM parquet_scan('{outside}/secret.txt'))",
    "EXISTS (FROM glob('{outside}/*'))",
    "EXISTS (FROM sniff_csv('{outside}/secret.txt'))",
    "EXISTS (FROM read_text('/etc/passwd'))",
    "EXISTS (FROM query('FROM read_text(''{outside}/secret.txt'')'))",
    "EXISTS (FROM query_table('{outside}/secret.txt'))",
    "EXISTS (FROM duckdb_settings())",
    "EXISTS (FROM duckdb_secrets())",
    "EXISTS (FROM duckdb_extensions())",
    "EXISTS (FROM pragma_database_list())",
    "EXISTS (FROM information_schema.tables)",
    "EXISTS (FROM sqlite_scan('{outside}/x', 'y'))",
    "EXISTS (FROM postgres_scan('host=localhost', 'a', 'b'))",
    "EXISTS (FROM read_parquet('https://example.org/x.parquet'))",
    "EXISTS (FROM read_parquet('s3://bucket/x.parquet'))",
    "getenv('HOME') <> ''",
    "current_setting('temp_directory') <> ''",
    "(ATTACH '{outside}/written')",
    "(INSTALL httpfs)",
    "(LOAD '{outside}/secret.txt')",
    "(SET memory_limit = '100GB')",
    "(PRAGMA database_list)",
    "(EXPORT DATABASE '{outside}/written')",
    "(IMPORT DATABASE '{outside}')",
    "(CALL dbgen(sf = 10))",
    "(COPY manifest TO '{outside}/written')",
    "(CREATE SECRET (TYPE s3))",
    "(VACUUM)",
    "length(repeat('x', 2000000000)) > 0",
    "length(repeat(repeat('x', 1000000), 100000)) > 0",
    "length(lpad('x', 2000000000, 'y')) > 0",
    "length(rpad('x', 2000000000, 'y')) > 0",
    "len(range(1000000000)) > 0",
    "len(generate_series(1, 1000000000)) > 0",
    "list_sum(range(1000000000)) > 0",
    "len(list_transform(range(100000000), x -> x * x)) > 0",
    "len(list_filter(range(100000000), x -> x % 2 = 0)) > 0",
    "list_reduce(range(100000000), (a, b) -> a + b) > 0",
    "len([i FOR i IN range(100000000) IF i % 3 = 0]) > 0",
    "length(format('{{:1000000000}}', 1)) > 0",
    "length(printf('%1000000000d', 1)) > 0",
    "length(bar(1, 0, 1, 1000000000)) > 0",
    "length(array_to_string(range(100000000), 'x')) > 0",
    "len(string_split(repeat('a,', 100000000), ',')) > 0",
    "len(regexp_extract_all(repeat('a', 100000000), 'a')) > 0",
    "length(regexp_replace(repeat('a', 10000000), 'a', repeat('b', 1000), 'g')) > 0",
    "regexp_matches(repeat('a', 1000000), '(a?){{1000}}a{{1000}}')",
    "length(replace(repeat('a', 10000000), 'a', repeat('b', 1000))) > 0",
    "levenshtein(repeat('a', 100000), repeat('b', 100000)) > 0",
    "length(translate(repeat('a', 1000000000), 'a', 'b')) > 0",
    "factorial(33) * factorial(33) * factorial(33) > 0",
    "2 ** 100000000 > 0",
    "length(to_json(range(100000000))) > 0",
    "length(hex(repeat('x', 1000000000))) > 0",
    "length(bin(repeat('x', 300000000))) > 0",
    "length(to_base64(repeat('x', 1000000000)::BLOB)) > 0",
    "('1' || repeat('0', 1000000000))::HUGEINT > 0",
    "len(flatten(list_transform(range(10000), x -> range(100000)))) > 0",
    "(SELECT count(*) FROM range(1000000) a, range(1000000) b WHERE hash(a, b) = 1) > 0",
    "(SELECT count(*) FROM manifest a, manifest b, manifest c, manifest d, manifest e, manifest f,"
    " manifest g, manifest h WHERE hash(a.key, h.key) = 1) > 0",
    "(WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT max(n) FROM t) > 0",
    "(WITH RECURSIVE t(s) AS (SELECT 'x' UNION ALL SELECT s || s FROM t) FROM t) = ''",
    "(SELECT max(length(x)) FROM (SELECT key || key AS x FROM manifest)) > 0",
    "(SELECT length(string_agg(repeat('x', 100000000), '')) FROM manifest) > 0",
    "(SELECT len(list(range(10000000))) FROM manifest) > 0",
    "(SELECT count(*) FROM manifest ORDER BY repeat(key, 10000000)) > 0",
    "(SELECT approx_quantile(x, 0.5) FROM (SELECT unnest(range(100000000)) x)) > 0",
    "(SELECT count(DISTINCT x) FROM (SELECT unnest(range(1000000000)) x)) > 0",
    "(" * 3000 + "true" + ")" * 3000,
    " AND ".join(["true"] * 600),
    "NOT " * 990 + "true",
    "key IN (" + ",".join(["'x'"] * 900) + ")",
    "'" + "x" * 30_000 + "' = key",
    "key = '\0'",
    "sleep(100)",
    "json_serialize_sql(repeat('(', 100000)) = ''",
    "nextval('x') > 0",
    "uuid()::VARCHAR = '' OR random() > 2 OR getvariable('x') = 1",
    "COLUMNS(*) = COLUMNS(*)",
    "#1 = 1",
    "? = 1",
    "$x = 1",
)


def try_conditions(base: Path, work: Path, limit: float) -> tuple[list[str], int]:
    """Through the page, whose limits hold; and through the user's own ways, which must not leak."""
    findings: list[str] = []
    beyond, largest = (0.0, ""), (0.0, "")
    place = make_place(base, work / "sql", lambda place: None)
    sandbox.SECONDS = limit
    kept = (place.out, place.outside, place.root / "cwd", place.root / "tmp")

    def page(where: str) -> None:
        app = create(Library(Folder(place.out)), Thumbnails(place.target), token=None, port=7)
        start = time.monotonic()
        answer = TestClient(app, base_url="http://localhost").get(
            "/api/shots", params={"where": where}
        )
        print(f"{time.monotonic() - start:.3f} seconds")
        print(answer.status_code, answer.content[:2000])
        if answer.status_code >= 500:
            raise AssertionError(answer.text[:100])

    def own(where: str) -> None:
        interrupt_after(limit)
        with contextlib.suppress(StorageError, ValueError, KeyboardInterrupt, MemoryError):
            open_dataset(place.out, where=where)

    def queried(where: str) -> None:
        interrupt_after(limit)
        with contextlib.suppress(StorageError, KeyboardInterrupt, MemoryError):
            print(manifest.query(place.out, f"SELECT key FROM manifest WHERE {where}").rows[:3])

    after = state(*kept)
    for condition in CONDITIONS:
        where = condition.format(outside=place.outside) if len(condition) < 500 else condition
        for what, ask in (("page", page), ("open_dataset", own), ("query", queried)):
            before, ages = after, age(place.outside)
            patience = 60.0 if what == "page" else limit + 1
            work_ = lambda ask=ask, where=where: ask(where)  # noqa: E731
            outcome = run(work_, place, patience, kept[2])
            touched = [p.name for p, then in ages.items() if p.stat().st_atime_ns != then]
            found = []
            after = state(*kept)
            if after != before or touched or outcome.opened:
                found.append(f"escapes: {touched} {outcome.opened[:2]}")
            if SECRET.decode() in outcome.said or "root:x:0" in outcome.said:
                found.append("tells the secret")
            if what == "page":
                asked = re.match(r"([\d.]+) seconds", outcome.said)
                late = (float(asked[1]) if asked else outcome.seconds) - limit
                beyond = max(beyond, (late, where[:60]))
                largest = max(largest, (outcome.megabytes, where[:60]))
                if outcome.stuck or late > 2:
                    found.append(f"takes {late:.1f} s more than its limit")
                if outcome.megabytes > HELD:
                    found.append(f"holds {outcome.megabytes:.0f} MB")
                if outcome.raised:
                    found.append(f"traceback: {outcome.raised[:200]}")
            findings += found
            for each in found:
                print(f"where {where[:60]}: {what}: {each}".encode("unicode_escape").decode())
    print(f"latest: {beyond[0]:+.1f} s, {beyond[1]}; largest: {largest[0]:.0f} MB, {largest[1]}")
    return findings, len(CONDITIONS)


def interrupt_after(seconds: float) -> None:
    """Ctrl-C after a while."""
    signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGINT))
    signal.setitimer(signal.ITIMER_REAL, seconds)


_MODULES = (
    *("OpenEXR", "OpenImageIO", "torch", "rich.table", "rich.progress", "typer.rich_utils"),
    *("synthgen.farm.preflight", "synthgen.farm.rerender", "synthgen.farm.recorded"),
    *("synthgen.farm.estimate", "synthgen.farm.calibration", "synthgen.publish.verify"),
    *("synthgen.publish.export", "synthgen.publish.answers", "synthgen.pictures.sheet"),
    *("synthgen.pictures.shot_sheet", "totalediting.data.shots", "assets_procedural.body.head"),
)


@contextlib.contextmanager
def dataset() -> Iterator[tuple[Path, Path]]:
    """A small dataset of the fake renderer, and a folder to work in."""
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        job = fake_renderer.small_job()
        in_child(lambda: render_job(job, work / "base", workers=1, renderer=fake_renderer.RENDERER))
        yield work / "base", work


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", action="append", default=[], help="only kinds that hold this")
    parser.add_argument("--seconds", type=float, default=30.0, help="that a run may take")
    parser.add_argument("--limit", type=float, default=2.0, help="seconds of the page's queries")
    parser.add_argument("--no-sql", action="store_true", help="leave the conditions out")
    parser.add_argument("--only-sql", action="store_true", help="leave the datasets out")
    arguments = parser.parse_args()
    rows: list[tuple[object, ...]] = []
    findings: list[str] = []
    with dataset() as (base, work):
        for name in _MODULES:  # once, and not in every child
            import_module(name)
        if not arguments.only_sql:
            kinds = chosen(arguments.kind)
            found, runs = try_datasets(base, work, kinds, arguments.seconds)
            rows.append(("hostile datasets", len(kinds), runs, *counts(found)))
            findings += found
        if not arguments.no_sql and not arguments.kind:
            found, conditions = try_conditions(base, work, arguments.limit)
            rows.append(("hostile conditions", conditions, 3 * conditions, *counts(found)))
            findings += found
    print()
    report.table(("what", "kinds", "runs", *(name for name, _ in SORTS)), rows)
    sys.exit(bool(findings))


SORTS = (
    ("escapes", ("changes", "reads outside", "tells", "escapes")),
    ("tracebacks", ("traceback",)),
    ("stuck or late", ("does not end", "takes")),
    ("terminal", ("sends the terminal",)),
    ("too much memory", ("holds",)),
)


def counts(findings: list[str]) -> list[int]:
    """Findings by sort."""
    return [sum(f.startswith(starts) for f in findings) for _, starts in SORTS]


if __name__ == "__main__":
    main()
