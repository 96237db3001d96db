"""`synthgen browse` is safe by default: only the dataset can be read, and nothing written."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import duckdb
import pytest
from starlette.testclient import TestClient

from synthgen.browse.app import create
from synthgen.browse.folder import Folder, Refused
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table import sandbox as sandboxes
from synthgen.browse.table.sandbox import Sandbox
from synthgen.browse.table.snapshot import Library
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.folder import StorageError
from synthgen.dataset.shards import tar_entry

SECRET = b"nobody shall read this"
SHOT = "multiview/s000002_p01"


def client(
    out: Path, cache: Path, token: str | None = None, base_url: str = "http://localhost"
) -> TestClient:
    app = create(Library(Folder(out)), Thumbnails(cache), token=token, port=7)
    return TestClient(app, base_url=base_url)


@pytest.fixture(scope="module")
def ask(small_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> TestClient:
    return client(small_dataset, tmp_path_factory.mktemp("thumbnails"))


@pytest.fixture
def copy(small_dataset: Path, tmp_path: Path) -> Path:
    """A copy of the small dataset that a test may turn hostile, with a secret beside it."""
    (tmp_path / "secret.txt").write_bytes(SECRET)
    return shutil.copytree(small_dataset, tmp_path / "copy")


def rewrite(out: Path, changes: str) -> None:
    """Change the multiview manifest by an SQL list of replacements: `expression AS column`."""
    path = out / "manifest" / "multiview.parquet"
    with duckdb.connect() as connection:
        text = f"COPY (SELECT * REPLACE ({changes}) FROM '{path}') TO '{path}.new'"
        connection.execute(f"{text} (FORMAT parquet)")
    Path(f"{path}.new").rename(path)


# ---------------------------------------------------------------- SQL


@pytest.mark.parametrize(
    "where",
    [
        "true; DROP TABLE manifest",
        "true) UNION ALL SELECT 1 FROM (SELECT 1",
        "true) OR (true",
        "true ORDER BY key",
        "true LIMIT 1",
        "true GROUP BY key",
        "true) LIMIT (1",
        "true QUALIFY true",
        "/* unfinished",
        "",
        "'",
        "view =",
        "EXISTS (SELECT * FROM read_text('/etc/passwd'))",
        "EXISTS (FROM read_csv('/etc/passwd'))",
        "EXISTS (FROM '/etc/passwd')",
        "EXISTS (FROM glob('/*'))",
        "EXISTS (FROM duckdb_settings())",
        "EXISTS (FROM duckdb_secrets())",
        "EXISTS (FROM information_schema.tables)",
        "EXISTS (FROM failures)",
        "EXISTS (FROM other.manifest)",
        "EXISTS (FROM query('SELECT 1'))",
        "EXISTS (FROM range(1000000000000))",
        "EXISTS (FROM client)",
        "getenv('HOME') = 'x'",
        "current_setting('threads') = 1",
        "(COPY manifest TO '/tmp/stolen.csv')",
        "(ATTACH '/tmp/other.db')",
        "(INSTALL httpfs)",
        "(SET threads = 9)",
        "(PRAGMA database_list)",
        "(CREATE TABLE t AS SELECT 1)",
        "x" * 5000,
        "view = 1\0",
    ],
)
def test_a_condition_is_one_expression_over_the_manifest(ask: TestClient, where: str):
    before = len(ask.get("/api/shots").json()["rows"])
    for path in ("/api/shots", "/api/counts"):
        # No condition at all is fine, but is none that this test is about.
        answer = ask.get(path, params={"where": where or "()"})
        assert answer.status_code == 400
        error = answer.json()["error"]
        assert error.startswith("where: ") and "\n" not in error
    assert len(ask.get("/api/shots").json()["rows"]) == before


@pytest.mark.parametrize(
    "where",
    [
        "len(range(1000000000)) > 0",
        "len(generate_series(1, 1000000000)) > 0",
        "len(repeat('x', 1000000000)) > 0",
        "len(repeat(environments, 100000000)) > 0",
        "len(lpad('x', 1000000000, 'y')) > 0",
        "len(rpad('x', 1000000000, 'y')) > 0",
        "len(format('{:>1000000000}', 'x')) > 0",
        "len(printf('%1000000000d', 1)) > 0",
        "len(list_resize([1], 1000000000)) > 0",
        "len(bar(1, 0, 1, 1000000000)) > 0",
        "len(replace(key, '', repeat('x', 1000000))) > 0",
        "len([x for x in range(100000000)]) > 0",
        "list_sum(list_transform(range(100000000), x -> x * x)) > 0",
        "list_reduce(environments, (a, b) -> a || b || a) = ''",
        "len(array_to_string(range(100000000), ',')) > 0",
        "len(bitstring('1', 1000000000)) > 0",
        "unnest(range(1000000000)) > 0",
        "levenshtein(key, subject) > 0",
        "(WITH RECURSIVE t AS (SELECT 1 n UNION ALL SELECT n + 1 FROM t) SELECT max(n) FROM t) > 0",
        "(WITH m AS (SELECT key FROM manifest) SELECT count(*) FROM m) > 0",
        "EXISTS (SELECT key || key a, a || a b, b || b c, c || c d, d || d e, e || e f, f || f g, "
        "g || g h, h || h i, i || i j FROM manifest WHERE len(j) > 0)",
        "(SELECT len(string_agg(key, ',')) FROM manifest) > 0",
        "(SELECT len(list(key)) FROM manifest) > 0",
        "(SELECT len(histogram(key)) FROM manifest) > 0",
        "(SELECT row_number() OVER () FROM manifest LIMIT 1) > 0",
        "sleep_ms(100000) IS NULL",
        "random() > 2",
        "nextval('s') > 0",
        "error('x') = 1",
    ],
)
def test_no_function_outruns_the_limits(ask: TestClient, where: str):
    start = time.monotonic()
    answer = ask.get("/api/shots", params={"where": where})
    assert time.monotonic() - start < 1
    assert answer.status_code == 400 and answer.json()["error"].startswith("where: ")


@pytest.mark.parametrize(
    "where",
    [
        "abs(camera_yaw) < 0.5 AND NOT person_hair_style LIKE 'b%'",
        "person_age_years BETWEEN 20 AND 40 OR subset IN ('video')",
        "environments[1] = 'city' OR list_contains(environments, 'night')",
        "CASE WHEN view = 0 THEN true ELSE round(head_yaw, 2) > 0 END",
        "camera_yaw > (SELECT avg(camera_yaw) FROM manifest)",
        "key IN (SELECT key FROM manifest GROUP BY key HAVING count(*) > 1)",
        "regexp_matches(key, '^s0') AND person_age_years::INT % 2 = 0",
        "coalesce(person_glasses_shape, '') <> ''",
    ],
)
def test_what_people_ask_for_is_allowed(ask: TestClient, where: str):
    answer = ask.get("/api/shots", params={"where": where})
    assert answer.status_code == 200, answer.json()


@pytest.mark.parametrize("in_memory", [True, False])
@pytest.mark.parametrize(
    "statement",
    [
        "SELECT * FROM read_text('{secret}')",
        "SELECT * FROM read_csv('{secret}')",
        "SELECT * FROM '{secret}'",
        "SELECT * FROM glob('{folder}/*')",
        "COPY (SELECT 1) TO '{folder}/written.csv'",
        "ATTACH '{folder}/other.db'",
        "EXPORT DATABASE '{folder}/exported'",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "SET allowed_directories = ['{folder}']",
        "SET memory_limit = '100GB'",
        "RESET lock_configuration",
        "SELECT * FROM statement",
    ],
)
def test_the_database_is_shut_even_to_what_was_not_checked(
    small_dataset: Path, tmp_path: Path, statement: str, in_memory: bool
):
    secret = tmp_path / "secret.txt"
    secret.write_bytes(SECRET)
    sandbox = Sandbox(1)
    file = small_dataset / "manifest" / "video.parquet"
    kind = "TABLE" if in_memory else "VIEW"
    sandbox.connection.execute(f"CREATE {kind} manifest AS SELECT * FROM read_parquet('{file}')")
    sandbox.lock([] if in_memory else [file])
    assert sandbox.ask("SELECT count(*) FROM manifest") == [(6,)]
    with pytest.raises(Refused):
        sandbox.ask(statement.format(secret=secret, folder=tmp_path))
    assert sorted(tmp_path.iterdir()) == [secret]


def test_a_query_that_takes_long_is_stopped(ask: TestClient, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sandboxes, "SECONDS", 0.3)
    tables = ", ".join(f"manifest AS m{i}" for i in range(9))
    where = f"(SELECT sum(hash(m0.key, m8.key) % 7) FROM {tables}) > 0"
    start = time.monotonic()
    answer = ask.get("/api/shots", params={"where": where})
    assert time.monotonic() - start < 5
    assert answer.status_code == 400
    assert "took more than 0.3 s and was stopped" in answer.json()["error"]
    assert ask.get("/api/shots").status_code == 200


def test_a_query_gets_no_more_memory_than_it_is_allowed(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(sandboxes, "_SCRATCH", 32 << 20)
    snapshot = Library(Folder(small_dataset)).snapshot()
    with pytest.raises(Refused, match=r"Out of Memory|memory"):
        snapshot.sandbox.ask("SELECT list(i) FROM range(100000000) AS t(i)")


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize(
    "path",
    [
        "/assets/../app.py",
        "/assets/%2e%2e/app.py",
        "/assets/..%2fapp.py",
        "/assets//etc/passwd",
        "/assets/%2fetc%2fpasswd",
        "/thumbnail/multiview/..%2f..%2fsecret.txt",
        "/thumbnail/../s000002_p01",
        "/member/multiview/s000002_p01/..%2f..%2fdataset.json",
        "/member/multiview/s000002_p01/%2fetc%2fpasswd",
        "/member/multiview/s000002_p01/meta.json%00",
        "/subject/multiview/..%2f..%2f..%2fsecret.glb",
        "/subject/..%2f..%2fsecret.txt/x.glb",
        "/lightmaps/..%2f..%2fsecret",
        "/lightmaps/%2e%2e",
        "/lightmaps/city%00",
        "/api/shot/multiview/'%20OR%20true",
        "/api/shot/%22%3B%20DROP/s000002_p01",
        "/api/subject/multiview/<script>",
        "/dataset.json",
        "/manifest/multiview.parquet",
    ],
)
def test_no_address_leads_out_of_the_dataset(ask: TestClient, path: str):
    answer = ask.get(path)
    assert 400 <= answer.status_code < 500
    assert b"root:" not in answer.content and b"def create" not in answer.content
    assert set(answer.json()) == {"error"}


@pytest.mark.parametrize(
    "shard",
    [
        *("../secret.txt", "{folder}/secret.txt", "data/../../secret.txt", "data/link.tar"),
        *("link/secret.txt", "data", "data/pipe.tar", "", ".", "data//x.tar", "data\\x.tar"),
    ],
)
def test_a_manifest_cannot_name_bytes_outside(copy: Path, tmp_path: Path, shard: str):
    member = tar_entry("s000002_p01.meta.json", SECRET)
    (tmp_path / "secret.txt").write_bytes(member)
    (copy / "data" / "link.tar").symlink_to(tmp_path / "secret.txt")
    (copy / "link").symlink_to(tmp_path)
    os.mkfifo(copy / "data" / "pipe.tar")
    name = shard.format(folder=tmp_path)
    rewrite(copy, f"'{name}' AS shard, 0 AS \"offset\", {len(member)} AS size")
    ask = client(copy, tmp_path / "cache")
    answers = [ask.get(f"/{kind}/{SHOT}{rest}") for kind, rest in (
        ("api/shot", ""), ("thumbnail", ""), ("pass", "/image"), ("values", "/depth"),
        ("member", "/meta.json"),
    )]  # fmt: skip
    assert all(SECRET not in answer.content for answer in answers)
    assert "shard" in answers[0].json()["broken"]
    assert "shard" in answers[1].headers["X-Broken"]
    assert [answer.status_code for answer in answers[2:]] == [422] * 3
    rows = ask.get("/api/shots", params={"where": "subset = 'multiview'"}).json()["rows"]
    assert all(row["broken"].startswith("shard ") for row in rows)


@pytest.mark.parametrize(
    "place", ["offset = -512", "size = 0", "size = 512000000", "offset = 9000000000000000"]
)
def test_a_manifest_cannot_name_bytes_that_are_not_its_own(copy: Path, tmp_path: Path, place: str):
    column, value = place.split(" = ")
    rewrite(copy, f'{value}::BIGINT AS "{column}"')
    answer = client(copy, tmp_path / "cache").get(f"/api/shot/{SHOT}")
    assert "is cut short" in answer.json()["broken"]


def test_a_key_reads_no_other_shots_members(copy: Path, tmp_path: Path):
    rewrite(copy, 'reverse("key") AS "key"')
    answer = client(copy, tmp_path / "cache").get("/api/shot/multiview/10p_200000s")
    assert "is not a member of 10p_200000s" in answer.json()["broken"]


@pytest.mark.parametrize(
    "mesh", ["../secret.txt", "{folder}/secret.txt", "dataset.json", "subjects/link.glb"]
)
def test_a_mesh_is_a_mesh_of_the_dataset(copy: Path, tmp_path: Path, mesh: str):
    (tmp_path / "secret.txt").write_bytes(b"glTF" + SECRET)
    (copy / "subjects" / "link.glb").symlink_to(tmp_path / "secret.txt")
    rewrite(copy, f"'{mesh.format(folder=tmp_path)}' AS mesh")
    answer = client(copy, tmp_path / "cache").get("/subject/multiview/s000002.glb")
    assert answer.status_code == 404 and SECRET not in answer.content


@pytest.mark.parametrize("name", ["manifest/multiview.parquet", "dataset.json"])
def test_what_describes_the_dataset_is_no_link_either(copy: Path, tmp_path: Path, name: str):
    (copy / name).rename(tmp_path / "elsewhere")
    (copy / name).symlink_to(tmp_path / "elsewhere")
    if name == "dataset.json":
        with pytest.raises(StorageError, match="is a symbolic link"):
            Library(Folder(copy))
        return
    ask = client(copy, tmp_path / "cache")
    # The parts that its shards left are read instead.
    assert ask.get("/api/dataset").json()["shots"] == 16


def test_the_folder_itself_may_be_a_link(small_dataset: Path, tmp_path: Path):
    (tmp_path / "link").symlink_to(small_dataset)
    ask = client(tmp_path / "link", tmp_path / "cache")
    assert ask.get(f"/api/shot/{SHOT}").json()["broken"] is None


# ---------------------------------------------------------------- hostile words


MARKUP = "<img src=x onerror=alert(1)>\"'&\r\nX-Evil: 1\u2028\ud800"


def test_words_of_a_dataset_stay_words(copy: Path, tmp_path: Path):
    failed = copy / "ledger" / "failed" / "multiview" / "s000009.json"
    failed.parent.mkdir(parents=True)
    entry = {"key": "s000009", "reason": MARKUP, "attempts": 3, "log": "", "subset": "multiview"}
    failed.write_text(json.dumps(entry))
    info = json.loads((copy / "dataset.json").read_text())
    info |= {"name": MARKUP, "environments": [{"id": MARKUP, "kind": 3}, "nonsense"]}
    (copy / "dataset.json").write_text(json.dumps(info))
    ask = client(copy, tmp_path / "cache")
    small = ask.get("/thumbnail/multiview/s000009")
    assert "<img" not in small.text and "&lt;img" in small.text
    assert "X-Evil" not in small.headers and "X-Evil: 1" in small.headers["X-Broken"]
    for path in ("/api/dataset", "/api/shots", "/api/shot/multiview/s000009"):
        answer = ask.get(path)
        assert answer.status_code == 200 and answer.headers["content-type"] == "application/json"
        answer.json()


def test_metadata_that_make_no_sense_are_a_broken_shot(copy: Path, tmp_path: Path):
    tar = copy / "data" / "multiview" / "hostile.tar"
    sources = {
        "nan": encode_json({"person": "{}"})[:-1] + b', "exposures": [NaN]}',
        "deep": b"[" * 100_000,
        "list": b"[]",
        "text": b"\xff\xfe",
        "none": b"",
    }
    for name, content in sources.items():
        member = tar_entry("s000002_p01.meta.json", content)
        tar.write_bytes(member)
        rewrite(
            copy,
            f"'data/multiview/hostile.tar' AS shard, 0 AS \"offset\", {len(member)} AS size",
        )
        ask = client(copy, tmp_path / name)
        assert ask.get(f"/api/shot/{SHOT}").json()["broken"], name
        assert ask.get(f"/pass/{SHOT}/depth").status_code == 422, name
        assert ask.get("/api/subject/multiview/s000002").status_code == 200, name
        assert ask.get("/subject/multiview/s000002/expressions").status_code in (404, 422), name


@pytest.mark.parametrize("content", [b"", b"PAR1 and nonsense", SECRET * 100])
def test_a_damaged_manifest_is_one_line(copy: Path, content: bytes):
    (copy / "manifest" / "multiview.parquet").write_bytes(content)
    with pytest.raises(StorageError, match="its manifest is damaged") as error:
        Library(Folder(copy))
    assert "\n" not in str(error.value) and SECRET.decode() not in str(error.value)


@pytest.mark.parametrize(
    "plan",
    [
        {"x\" AS SELECT 1; COPY (SELECT 1) TO '/tmp/x": {}},
        {"../copy/manifest": {}},
        {"": {}},
        {".": {}},
        ["multiview"],
        {"multiview": 3},
        None,
    ],
)
def test_subsets_have_names_and_nothing_else(copy: Path, plan: Any):
    info = json.loads((copy / "dataset.json").read_text())
    (copy / "dataset.json").write_text(json.dumps(info | {"plan": plan}))
    with pytest.raises(StorageError, match="plan") as error:
        Library(Folder(copy))
    assert "\n" not in str(error.value)


def test_columns_with_hostile_names_are_only_names(copy: Path, tmp_path: Path):
    path = copy / "manifest" / "multiview.parquet"
    name = 'x""; DROP TABLE manifest; --'
    with duckdb.connect() as connection:
        text = f"COPY (SELECT *, 1.5 AS \"{name}\", 'seen' AS failed FROM '{path}') TO '{path}.new'"
        connection.execute(f"{text} (FORMAT parquet)")
    Path(f"{path}.new").rename(path)
    ask = client(copy, tmp_path / "cache")
    plain = name.replace('""', '"')
    found = ask.get("/api/shots", params={"ranges": json.dumps({plain: [1, 2]}), "sort": plain})
    assert found.json()["total"] == 10 and found.json()["rows"][0][plain] == 1.5
    assert ask.get("/api/counts").json()["histograms"][plain]["counts"] == [10]
    assert all(row["failed"] is False for row in found.json()["rows"])


# ---------------------------------------------------------------- who may ask


def test_every_address_asks_for_the_token(small_dataset: Path, tmp_path: Path):
    ask = client(small_dataset, tmp_path, token="right", base_url="http://example.org")
    paths = ["/", "/assets/index.html", "/api/dataset", f"/thumbnail/{SHOT}", "/nowhere"]
    for path in paths:
        for query in ("", "?token=", "?token=wrong", "?token=right%00"):
            answer = ask.get(path + query)
            assert answer.status_code == 401 and set(answer.json()) == {"error"}
    assert ask.post("/lightmaps", content=b"x").status_code == 401
    assert ask.get("/api/dataset?token=right").status_code == 200
    # The first page takes the token out of the address and into a cookie.
    answer = ask.get("/?where=view+%3D+1&token=right", follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/?where=view+%3D+1")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=strict" in cookie
    assert ask.get("/api/dataset").status_code == 200


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"host": "127.0.0.1:8350"}, 200),
        ({"host": "[::1]:8350"}, 200),
        ({"host": "evil.example"}, 403),
        ({"host": "localhost.evil.example"}, 403),
        ({"host": ""}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"sec-fetch-site": "same-origin"}, 200),
        ({"sec-fetch-site": "none"}, 200),
        ({"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, 403),
    ],
)
def test_other_sites_cannot_ask(ask: TestClient, headers: dict[str, str], status: int):
    assert ask.get("/api/dataset", headers=headers).status_code == status


@pytest.mark.parametrize(
    ("path", "destination", "status"),
    [
        ("/", "document", 200),
        ("/?where=view+%3D+1", "document", 200),
        ("/", "iframe", 403),
        ("/api/shots?where=true", "document", 403),
        ("/assets/index.html", "document", 403),
    ],
)
def test_other_sites_can_link_to_the_page_alone(
    ask: TestClient, path: str, destination: str, status: int
):
    headers = {
        "sec-fetch-site": "cross-site",
        "sec-fetch-mode": "navigate",
        "sec-fetch-dest": destination,
    }
    assert ask.get(path, headers=headers).status_code == status


def test_every_answer_forbids_what_no_page_needs(ask: TestClient):
    for path in ("/", "/assets/index.html", "/api/shots", f"/thumbnail/{SHOT}", "/nowhere"):
        headers = ask.get(path).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert "access-control-allow-origin" not in headers
    assert "sandbox" in ask.get(f"/member/{SHOT}/meta.json").headers["content-security-policy"]


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_elsewhere_than_on_loopback_the_command_prints_a_token(small_dataset: Path, host: str):
    code = "from synthgen.cli import main; main()"
    command = [sys.executable, "-c", code, "browse", str(small_dataset)]
    process = subprocess.Popen(
        [*command, "--host", host, "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = line.split()[1]
        local = address.replace("0.0.0.0", "127.0.0.1")
        with urllib.request.urlopen(
            local.replace("/?", "/api/dataset?") if "token" in local else f"{local}api/dataset"
        ) as answer:
            assert json.load(answer)["name"] == "small"
        assert ("?token=" in address) == (host == "0.0.0.0")
        if host == "0.0.0.0":
            with pytest.raises(urllib.error.HTTPError, match="401"):
                urllib.request.urlopen(local.split("?")[0])
    finally:
        process.terminate()
        process.wait(timeout=10)


def test_a_condition_nested_deeply_is_refused(ask: TestClient):
    for where in ("NOT " * 990 + "true", "(" * 1500 + "true" + ")" * 1500):
        answer = ask.get("/api/shots", params={"where": where})
        assert answer.status_code == 400 and "\n" not in answer.json()["error"]
