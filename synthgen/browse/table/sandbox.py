"""A DuckDB that can only answer queries: no files, no extensions, no settings, limited time.

What a user types is never run as it stands. It is parsed first and must be one expression over the
manifest's columns; then it runs in a database of its own that the rest of the machine is shut to.
"""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import duckdb
import numpy as np

from synthgen.browse.folder import Refused
from synthgen.dataset import database

SECONDS = 10.0
"""What a query may take."""
ROWS = 500
"""What a query that a user shapes may return."""
_LONGEST = 4000  # characters of a condition
_SCRATCH = 1 << 30  # bytes that queries may take beside the table


class Sandbox:
    """A database in memory. Fill it through `connection`, then `lock` it, then only `ask`.

    `ask` may be called from several threads.
    """

    def __init__(self, threads: int) -> None:
        # Until it is locked it holds the table, however large that is.
        self.connection = database.connect(threads, memory_limit="80%")

    def lock(self, readable: list[Path]) -> None:
        """Shut the database to all files but `readable`, and to any change of its settings."""
        sql = "SELECT sum(memory_usage_bytes) FROM duckdb_memory()"
        used = self.connection.execute(sql).fetchone()
        most = int(used[0] if used else 0) + _SCRATCH
        database.lock(self.connection, readable, memory=f"{most} B")

    def ask(self, sql: str, values: list[Any] | None = None) -> list[tuple[Any, ...]]:
        """The rows of one SELECT. Raises `Refused` (400) for a wrong one or one that takes long."""
        return self._run(sql, values, lambda answer: answer.fetchall())

    def arrays(self, sql: str, values: list[Any] | None = None) -> dict[str, np.ndarray]:
        """The answer as a (masked) array per column; raises as `ask`."""
        return self._run(sql, values, lambda answer: answer.fetchnumpy())

    def _run(self, sql: str, values: list[Any] | None, fetch: Any) -> Any:
        late = threading.Event()
        with self.connection.cursor() as cursor:

            def stop() -> None:
                late.set()
                cursor.interrupt()

            timer = threading.Timer(SECONDS, stop)
            timer.daemon = True
            timer.start()
            try:
                return fetch(cursor.execute(sql, values or []))
            except (duckdb.Error, RuntimeError) as error:
                if late.is_set():
                    reason = f"the selection took more than {SECONDS:g} s and was stopped"
                    raise Refused(f"{reason}; narrow it down", 400) from None
                raise Refused(f"where: {_one_line(error)}", 400) from None
            finally:
                timer.cancel()

    def check(self, condition: str) -> None:
        """Raise `Refused` (400) unless `condition` is one SQL expression over the manifest.

        It may hold subqueries, of the manifest alone, and no functions that make tables.
        """
        if len(condition) > _LONGEST:
            raise Refused(f"where: longer than {_LONGEST} characters; shorten it", 400)
        if "\0" in condition:
            raise Refused("where: contains a null byte; remove it", 400)
        try:
            self._check_tree(condition)
        except RecursionError:
            raise Refused("where: is nested too deeply; simplify it", 400) from None

    def _check_tree(self, condition: str) -> None:
        # Without brackets, else `a) OR (b` would be one expression and two in our sentence.
        self._parsed(f"SELECT 1 FROM manifest WHERE {condition}\n")
        found = self._parsed(f"SELECT 1 FROM manifest WHERE ({condition}\n)")
        plain = self._parsed("SELECT 1 FROM manifest WHERE (true\n)")
        expression = found["statements"][0]["node"].pop("where_clause", None)
        plain["statements"][0]["node"].pop("where_clause")
        if found != plain or expression is None:
            raise Refused(
                "where: must be a single condition, such as person_age_years > 60, without "
                "ORDER BY, GROUP BY, LIMIT or UNION",
                400,
            )
        _walk(expression)

    def _parsed(self, sql: str) -> dict[str, Any]:
        tree = json.loads(self.ask("SELECT json_serialize_sql(?::VARCHAR)", [sql])[0][0])
        if tree.get("error"):
            raise Refused(f"where: {_one_line(tree.get('error_message', 'not SQL'))}", 400)
        if len(tree["statements"]) != 1:
            raise Refused("where: must be a single condition, not several statements", 400)
        return tree


# All that a condition may be made of. DuckDB looks at its limits of time and memory between batches
# of rows, never inside one call of a function: what makes much of little (range, repeat, lpad,
# format, list_transform, …) would outrun them, so what is not named here is refused.
_FUNCTIONS = """
    + - * / // % ** ^ & | << >> ~ ! @
    abs sign round floor ceil ceiling trunc sqrt cbrt exp ln log log2 log10 pow power mod
    sin cos tan asin acos atan atan2 degrees radians pi greatest least isnan isinf isfinite
    ~~ !~~ ~~* !~~* ~~~ like_escape ilike_escape not_like_escape not_ilike_escape
    regexp_matches regexp_full_match contains starts_with ends_with prefix suffix
    lower upper trim ltrim rtrim length len strlen substr substring left right split_part instr
    strpos position || concat hash md5 coalesce ifnull nullif if
    list_contains list_has array_contains array_has list_has_any array_has_any list_has_all
    array_has_all list_position list_min list_max list_sum list_avg list_value array_extract
    list_extract element_at map_extract map_contains map_keys map_values struct_extract struct_pack
    row map cardinality
    count count_star sum avg mean min max median stddev stddev_samp stddev_pop variance var_samp
    bool_and bool_or any_value
    """
_CLASSES = """
    BETWEEN CASE CAST COLLATE COLUMN_REF COMPARISON CONJUNCTION CONSTANT FUNCTION OPERATOR SUBQUERY
    TYPE STAR
    """
_allowed_functions, _allowed_classes = frozenset(_FUNCTIONS.split()), frozenset(_CLASSES.split())
_MOST_JOINS_OF_TEXT = 8  # each may double a text, by an alias for one


def _walk(node: Any) -> int:
    """Refuse what is not allowed; returns how many texts are joined."""
    if isinstance(node, list):
        return _few(sum(map(_walk, node)))
    if not isinstance(node, dict):
        return 0
    kind, function = node.get("type"), str(node.get("function_name", "")).lower()
    if kind == "TABLE_FUNCTION":
        name = node.get("function", {}).get("function_name", "?")
        raise Refused(
            f"where: the function {name} returns a table; only manifest can be queried", 400
        )
    if kind == "BASE_TABLE" and (
        node.get("table_name") != "manifest" or node.get("schema_name") or node.get("catalog_name")
    ):
        raise Refused(
            f"where: no table {node.get('table_name')}; only manifest can be queried", 400
        )
    if (is_a := node.get("class")) is not None and is_a not in _allowed_classes:
        raise Refused(f"where: {is_a.lower()} expressions are not available here", 400)
    if is_a == "FUNCTION" and function not in _allowed_functions:
        raise Refused(f"where: the function {function} is not available here", 400)
    if kind in ("RECURSIVE_CTE_NODE", "CTE_NODE") or (node.get("cte_map") or {}).get("map"):
        raise Refused("where: WITH is not available here", 400)
    joined = function in ("||", "concat")
    return _few(joined + sum(map(_walk, node.values())))


def _few(joined: int) -> int:
    if joined > _MOST_JOINS_OF_TEXT:
        raise Refused(f"where: joins more than {_MOST_JOINS_OF_TEXT} texts; join fewer", 400)
    return joined


def _one_line(error: Any) -> str:
    # Later lines draw the query that was made of the condition.
    lines = str(error).strip().splitlines() or [type(error).__name__]
    hints = [line for line in lines[1:] if line.startswith(("Candidate", "Did you mean"))]
    return " ".join(" ".join([lines[0], *hints[:1]]).split())[:300]
