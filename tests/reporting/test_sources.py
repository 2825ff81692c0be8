import pytest

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
