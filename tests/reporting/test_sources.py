import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import hmi_marl
from hmi_marl.reporting.sources import Citation, pointer, resolve

CONTENT = {"rows": [{"own - AvgHMI": 1.5, "a/b~c": {"": 0}}], "0": "text"}


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ((), CONTENT),
        (("rows", 0, "own - AvgHMI"), 1.5),
        (("rows", 0, "a/b~c"), {"": 0}),
        (("rows", 0, "a/b~c", ""), 0),
        (("0",), "text"),
    ],
)
def test_a_pointer_leads_to_what_its_keys_lead_to(keys, found) -> None:
    assert resolve(CONTENT, pointer(*keys)) == found


def test_names_are_written_as_the_standard_has_them() -> None:
    assert pointer("a/b", "m~n", 0) == "/a~1b/m~0n/0"


@pytest.mark.parametrize("place", ["/row", "/rows/1", "/rows/-1", "/rows/first", "/0/0", "rows"])
def test_what_is_not_there_is_named(place: str) -> None:
    with pytest.raises(ValueError, match=r"names nothing|begins with /"):
        resolve(CONTENT, place)


def test_a_citation_links_the_command_and_every_place() -> None:
    cited = Citation("hmi-marl <bench>", "b.json", "/in")
    html = cited.as_html(["/a b", "/η"])
    assert "<code>hmi-marl &lt;bench&gt;</code> →" in html
    assert '<a href="b.json#/in/a%20b"><code>b.json#/in/a b</code></a>' in html
    assert '<a href="b.json#/in/%CE%B7">' in html
    assert cited.as_html([]) == ""


PACKAGE = Path(hmi_marl.__file__).parent
BEFORE_SOURCES = {"Table": 4, "Figure": 6, "Clip": 3}
"""Arguments before the sources, of each kind of block; ``Table.of`` has as many as a table."""
WITHOUT = {
    "score_tables": "printed by whoever measures pairs; no command writes them",
    "signalling_tables": "the same",
    "plan_table": "of what a sweep would do, printed by --dry-run",
    "card": "a figure on a card, which has the sources",
}


def without_sources(tree: ast.Module) -> Iterator[str]:
    """Functions that make a table, figure or clip without sources; a matplotlib figure is none."""
    imported = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module == "hmi_marl.reporting.blocks"
        for alias in node.names
        if alias.asname is None
    }
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in ast.walk(function):
            if not isinstance(node, ast.Call):
                continue
            called = node.func.value if isinstance(node.func, ast.Attribute) else node.func
            kind = called.id if isinstance(called, ast.Name) else ""
            if kind not in BEFORE_SOURCES.keys() & imported:
                continue
            named = any(keyword.arg == "sources" for keyword in node.keywords)
            if not named and len(node.args) <= BEFORE_SOURCES[kind]:
                yield function.name


def test_a_block_without_sources_is_found() -> None:
    lines = (
        "from hmi_marl.reporting.blocks import Figure, Table",
        "def one(): return Table('', [], [], '')",
        "def other(): return Table.of('', [], {}, '', ['/rows'])",
        "def third(): return [Figure('f', '', draw)]",
        "def fourth(): return [Figure('f', '', draw, sources=SOURCES), Clip('c', '')]",
    )
    assert list(without_sources(ast.parse("\n".join(lines)))) == ["one", "third"]


def test_every_table_figure_and_clip_of_the_package_has_sources() -> None:
    found = {
        function
        for path in PACKAGE.rglob("*.py")
        for function in without_sources(ast.parse(path.read_text("utf-8")))
    }
    assert found == WITHOUT.keys()
